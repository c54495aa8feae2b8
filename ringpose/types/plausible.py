"""Plausible ranges of the quantities in files and options, and the likely causes of a value outside of them.

The ranges are wider than anything that is built or planned: a value outside of them is in another unit, or in the place
of another one. Readers refuse it, with what it would be in the units that are often mistaken for the right one.
"""

from dataclasses import dataclass
from math import pi

UNITS = {
    "millimetres": 1e-3,
    "centimetres": 1e-2,
    "micrometres": 1e-6,
    "nanometres": 1e-9,
    "degrees": pi / 180,
    "milliradians": 1e-3,
    "milliwatts": 1e-3,
    "milliseconds": 1e-3,
    "microseconds": 1e-6,
    "nanoseconds": 1e-9,
    "millimetres a second": 1e-3,
    "degrees a second": pi / 180,
}
"""Units that are given by mistake, in SI units."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Range:
    """The plausible values of a quantity, both bounds included."""

    quantity: str
    """Where the quantity occurs, as the manual names it."""
    lowest: int | float
    highest: int | float
    unit: str = ""
    mistaken: tuple[str, ...] = ()
    """Names in `UNITS` of the units that are often given instead."""

    def holds(self, value: int | float) -> bool:
        """Whether a value is in the range; NaN is not."""
        return self.lowest <= value <= self.highest

    @property
    def bounds(self) -> str:
        """`0.02 to 5`."""
        return f"{self.lowest:g} to {self.highest:g}"

    def finding(self, value: int | float) -> tuple[str, str]:
        """What is wrong with a value outside of the range, and the remedy with the value in other units."""
        remedy, likely = f"give {self.unit}" if self.unit else "", self.likely(value)
        return f"is {value:g}, must be {self.bounds}", f"{remedy}: {likely}" if likely else remedy

    def likely(self, value: int | float) -> str:
        """What the value would be in the mistaken units in which it is plausible; empty if it is so in none."""
        meanings = [(value * UNITS[unit], unit) for unit in self.mistaken if value]
        return ", ".join(f"{meant:.4g} if it is in {unit}" for meant, unit in meanings if self.holds(meant))


def _metres(quantity: str, lowest: int | float, highest: int | float, *mistaken: str) -> Range:
    units = mistaken or ("millimetres", "centimetres")
    return Range(quantity=quantity, lowest=lowest, highest=highest, unit="metres", mistaken=units)


def _radians(quantity: str, lowest: int | float, highest: int | float, *more: str) -> Range:
    return Range(quantity=quantity, lowest=lowest, highest=highest, unit="radians", mistaken=("degrees", *more))


def _seconds(quantity: str, lowest: int | float, highest: int | float) -> Range:
    units = ("milliseconds", "microseconds")
    return Range(quantity=quantity, lowest=lowest, highest=highest, unit="seconds", mistaken=units)


# Camera

FOCAL_LENGTH = Range(quantity="focal length, in image sizes", lowest=0.05, highest=1000, unit="pixels, not mm")
PRINCIPAL_POINT = Range(quantity="principal point from the middle, in image sizes", lowest=-1.5, highest=1.5)
CENTRAL_POINT = Range(quantity="principal point from the middle, without a hint", lowest=-0.12, highest=0.12)

TANGENTIAL = Range(quantity="p1 and p2 of a lens that folds the image", lowest=-0.05, highest=0.05)

# Rig and robot

PLANE_DISTANCE_M = _metres("distance of a light plane or projector from the camera, each axis", -5, 5)
MOUNT_M = _metres("camera in the tool frame, each axis", -5, 5)
REACH_M = _metres("tool in the robot's base frame, each axis", -100, 100)
DELAY_S = _seconds("delay of the mount", -10, 10)
DELAY_SD_S = _seconds("standard deviation of the delay", 0, 10)
ROBOT_SD_RAD = _radians("standard deviation of the robot's orientation, each axis", 0, 0.2)
ROBOT_SD_M = _metres("standard deviation of the robot's position, each axis", 0, 0.2)
STABILITY_TILT_RAD = _radians("stability of a light plane, tilt", 0, 0.2)
STABILITY_DISTANCE_M = _metres("stability of a light plane, distance", 0, 0.1)
STABILITY_FOCAL = Range(quantity="stability of the focal length, as a share", lowest=0, highest=0.2)
STABILITY_FACTOR = Range(
    quantity="factor on the rig's stability", lowest=0, highest=1000, unit="a factor, 1 for the rig file's stability"
)

# Boards

SQUARE_M = _metres("square or spacing of a board", 0.0005, 1)
MARKER_M = _metres("marker or gap of a board", 0.0002, 1)
MARGIN_M = _metres("margin of a board", 0, 1)
BOARD_M = _metres("width or height of a board", 0.005, 5)

# The ring and the rest of the target

RING_RADIUS_M = _metres("radius of a ring", 0.02, 5)
RADIUS_SD_M = _metres("standard deviation of a radius, which is at most a fifth of it", 1e-6, 1)
FACE_WIDTH_M = _metres("width of a ring's face", 0.0005, 1)
RING_HEIGHT_M = _metres("height of a ring", 0.0005, 2)
RING_TOLERANCE_M = _metres("standard deviation of a ring's form", 0, 0.05)
RING_FORM_M = _metres("deviation of a ring's form", -0.01, 0.01)
PART_M = _metres("size or position of a part of the target, each axis", -50, 50)
DETAIL_M = _metres("body, foil or grid of the target", -5, 5)
ANGLE_RAD = _radians("angle of a part, a gap or a roll", -7, 7)
FACE_SLOPE_DEG = Range(quantity="standard deviation of the slope of a face", lowest=0, highest=20, unit="degrees")
SLOPE_RAD = _radians("slope of a ring's face", -0.5, 0.5)

# Where the target is, and how it moves

DISTANCE_M = _metres("distance of ring or board that is chosen or varied", 0.05, 20)
TARGET_DISTANCE_M = _metres("distance of the target in views and truth", 0.05, 200)
TILT_RAD = _radians("tilt, clock or turn of random views", 0, 1.2)
FACING_RAD = _radians("pitch or yaw of a view", -1.5, 1.5)
OFFSET_SHARE = Range(quantity="offset of random views from the middle, in image sizes", lowest=0, highest=0.5)
PATH_M = _metres("distance from the origin along a path", 0, 200)
SPEED_M_S = Range(
    quantity="speed of the target", lowest=0, highest=10, unit="metres a second", mistaken=("millimetres a second",)
)
RATE_RAD_S = Range(
    quantity="rate of the target", lowest=0, highest=0.5, unit="radians a second", mistaken=("degrees a second",)
)
LATENCY_S = Range(
    quantity="latency of a line in a study", lowest=0, highest=10, unit="seconds", mistaken=("milliseconds",)
)
RATE_SD_RAD_S = Range(
    quantity="standard deviation of the rate in a study", lowest=0, highest=1, unit="radians a second",
    mistaken=("degrees a second",),
)  # fmt: skip
MAX_RATE_DEG_S = Range(
    quantity="largest rate that a pose assumes, in degrees", lowest=0, highest=720, unit="degrees a second"
)
MAX_RATE_RAD_S = Range(
    quantity="largest rate that a study assumes", lowest=0, highest=12.6, unit="radians a second",
    mistaken=("degrees a second",),
)  # fmt: skip
GRIPPER_M = _metres("gripper's tolerance across the band", 0, 0.5)

# Light and sensor

LASER_POWER_W = Range(quantity="power of a laser", lowest=0, highest=1, unit="watts", mistaken=("milliwatts",))
SHEET_M = _metres("half thickness of a sheet of light", 1e-6, 0.01, "millimetres", "micrometres")
DIVERGENCE_RAD = _radians("divergence of a sheet of light", 0, 0.05, "milliradians")
FAN_RAD = _radians("fan of a laser", 1e-6, pi)
BOW_PER_RAD = Range(quantity="bow of a sheet of light", lowest=-0.5, highest=0.5, unit="one by radians")
GHOST_PX = Range(quantity="offset of a ghost", lowest=-500, highest=500, unit="pixels")
IRRADIANCE_W_M2 = Range(quantity="irradiance", lowest=0, highest=5000, unit="watts a square metre")
SUN_RAD = _radians("diameter of the sun", 0, 0.2)
STRIPE_DN = Range(quantity="brightness of the stripes in a study", lowest=5, highest=10000, unit="grey values")
F_NUMBER = Range(quantity="f-number", lowest=0.5, highest=100, unit="focal length by diameter of the pupil")
BLUR_PX = Range(quantity="blur of the lens", lowest=0, highest=20, unit="pixels")
PIXEL_M = _metres("pitch of the pixels", 1e-7, 1e-4, "micrometres", "millimetres")
WAVELENGTH_M = _metres("wavelength", 2e-7, 2e-6, "nanometres", "micrometres")
EXPOSURE_S = _seconds("exposure", 1e-6, 60)
STAMP_S = Range(
    quantity="stamp: up to the year 2100", lowest=0, highest=4_102_444_800, unit="seconds",
    mistaken=("milliseconds", "microseconds", "nanoseconds"),
)  # fmt: skip

# Studies, and rigs that are tried

RISK = Range(quantity="risk of a protection level", lowest=1e-9, highest=0.1)
SHARE = Range(quantity="share", lowest=0, highest=1, unit="a share")

LASER_ANGLE_RAD = _radians("angle of the outer lasers", 0.001, 0.7)
BASELINE_M = _metres("baseline", 0.005, 2)
FOCAL_PX = Range(quantity="focal length that is tried", lowest=50, highest=1e5, unit="pixels")
DARK_NOISE_E = Range(quantity="dark noise", lowest=0, highest=1000, unit="electrons")
EXPECTED_DEG = Range(quantity="angle between lasers, in degrees", lowest=0, highest=180, unit="degrees")
OFFSET = Range(quantity="offset from the middle, in image sizes", lowest=-0.5, highest=0.5)
LASERS = Range(quantity="number of lasers", lowest=1, highest=8, unit="numbers of lasers")

RANGES = tuple(value for value in globals().values() if isinstance(value, Range))
"""All of them, in this order: the table in ringpose-conventions(7)."""
