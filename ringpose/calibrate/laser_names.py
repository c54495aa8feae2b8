"""How the lasers are called, in the order of a shot's mask bits."""

from ringpose.errors import DataError, UsageError
from ringpose.types.frame import ALL_LASERS, Shot
from ringpose.types.sequence import MOST_LASERS

THREE = ("left", "middle", "right")


def laser_names(given: str | None, shot: Shot) -> tuple[str, ...]:
    """The names that were given, comma between; else left, middle, right for three lasers, laser_1, laser_2 for others.

    The number of lasers is that of the names, else that which the shot's masks speak of.
    """
    if given is not None:
        names = tuple(name.strip() for name in given.split(","))
        if (
            not all(names)
            or len(set(names)) < len(names)
            or any("." in name for name in names)
            or len(names) > MOST_LASERS
        ):
            raise UsageError(
                "--laser-names", f"{given!r} are no names", "give one to eight different ones, as left,right"
            )
        return names
    masks = [int(mask) for mask in shot.lasers if mask != ALL_LASERS]
    number = max(masks, default=0).bit_length()
    if number == 0:
        found = "does not say how many lasers are on"
        raise DataError(shot.name, found, "give --laser-names with one name for each laser")
    return THREE if number == len(THREE) else tuple(f"laser_{i + 1}" for i in range(number))


def laser_order(given: str | None, names: tuple[str, ...]) -> tuple[int, ...] | None:
    """The lasers in the order in which their stripes cross the image; a single one needs none."""
    if given is None:
        return (0,) if len(names) == 1 else None
    order = [name.strip() for name in given.split(",")]
    if sorted(order) != sorted(names):
        raise UsageError(
            "--laser-order", f"{given!r} is no order of the lasers", f"give {','.join(names)} in their order"
        )
    return tuple(names.index(name) for name in order)
