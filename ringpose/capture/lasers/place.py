"""What a laser driver may have to know of its surroundings."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeAlias

from ringpose.capture.lasers.driver import LaserDriver
from ringpose.capture.uri import DeviceUri
from ringpose.types.sequence import MOST_LASERS


@dataclass(frozen=True, slots=True, kw_only=True)
class LaserPlace:
    """The rig that the lasers belong to, and the camera that looks at them."""

    names: tuple[str, ...] | None = None
    """Of the rig's lasers, in its order; None where no rig is given."""
    camera: object | None = None
    """The camera's driver, which may also have output lines; None for a simulated one, made after its lasers."""


LaserFactory: TypeAlias = Callable[[DeviceUri, LaserPlace], LaserDriver]
"""What an entry point of the group `ringpose.lasers` names."""


def channels(uri: DeviceUri, place: LaserPlace) -> tuple[str, ...]:
    """The channel of each laser, in the rig's order: `ch=1,2,3`, or by name `ch=left:1,right:3,middle:2`."""
    words = [word.strip() for word in uri.parameters.get("ch", "").split(",")]
    if not all(words):
        raise uri.problem("does not say which channels feed the lasers (ch=)", "write it as ?ch=1,2,3")
    named = dict(word.partition(":")[::2] for word in words)
    by_name = any(":" in word for word in words)
    chosen = _by_name(uri, place, named, len(words)) if by_name else tuple(words)
    if len(set(chosen)) < len(chosen):
        raise uri.problem("names a channel twice (ch=)")
    if len(chosen) > MOST_LASERS:
        raise uri.problem(f"has {len(chosen)} channels; a mask has room for {MOST_LASERS} lasers")
    if place.names is not None and len(chosen) != len(place.names):
        raise uri.problem(f"has {len(chosen)} channels for the {len(place.names)} lasers of the rig")
    return chosen


def _by_name(uri: DeviceUri, place: LaserPlace, named: dict[str, str], count: int) -> tuple[str, ...]:
    if place.names is None:
        raise uri.problem("names lasers, but there is no rig that says their order", "add --rig FILE")
    if set(named) != set(place.names) or count != len(place.names) or not all(named.values()):
        raise uri.problem(f"must name each of the rig's lasers once: {', '.join(place.names)}")
    return tuple(named[name] for name in place.names)
