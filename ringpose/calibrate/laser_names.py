"""How the lasers are called, in the order of a shot's mask bits."""

from ringpose.errors import UsageError
from ringpose.types.frame import ALL_LASERS, Shot
from ringpose.types.sequence import MOST_LASERS

THREE = ("left", "middle", "right")


def laser_names(given: str | None, number: int) -> tuple[str, ...]:
    """The names that were given, comma between; else left, middle, right for three lasers, laser_1, laser_2 for others.

    `number` is how many lasers the shots' masks speak of.
    """
    if given is None:
        return THREE if number == len(THREE) else tuple(f"laser_{i + 1}" for i in range(number))
    names = tuple(name.strip() for name in given.split(","))
    if not all(names) or len(set(names)) < len(names) or any("." in name for name in names) or len(names) > MOST_LASERS:
        raise UsageError("--laser-names", f"{given!r} are no names", "give one to eight different ones, as left,right")
    return names


def lasers_named(shot: Shot) -> int:
    """How many lasers the shot's masks speak of; none where all were on, however many there are."""
    return max((int(mask) for mask in shot.lasers if mask != ALL_LASERS), default=0).bit_length()


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
