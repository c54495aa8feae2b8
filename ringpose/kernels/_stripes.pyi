from ringpose.types.arrays import Array

def stripes(
    image: Array,
    dark: Array | None,
    bands: Array | None,
    taps: Array,
    figures: Array,
    rules: tuple[float, float, float, float, float, int, int],
    /,
) -> tuple[bytearray, bytearray, bytearray, bytearray]: ...
