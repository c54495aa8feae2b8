"""Features by their names in the Standard Features Naming Convention, and what older cameras call them."""

ALIASES = {
    "ExposureTime": ("ExposureTime", "ExposureTimeAbs"),
    "Gain": ("Gain", "GainAbs", "GainRaw"),
    "AcquisitionFrameRate": ("AcquisitionFrameRate", "AcquisitionFrameRateAbs"),
    "UserOutputValueAll": ("UserOutputValueAll", "UserOutputValueAllRaw"),
    "DeviceTemperature": ("DeviceTemperature", "DeviceTemperatureAbs", "TemperatureAbs"),
}

SATURATION_DN = {"Mono8": 255, "Mono10": 1023, "Mono12": 4095, "Mono14": 16383, "Mono16": 65535}
"""The last grey value of the pixel formats that a driver can be asked for."""


def spellings(feature: str) -> tuple[str, ...]:
    """Under which names a feature may be found, the standard one first."""
    return ALIASES.get(feature, (feature,))
