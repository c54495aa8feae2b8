"""The options of `ringpose pose` that give the ring's radii."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, ClassVar

import typer

from ringpose.cli.app import KNOWN_RING, check_plausible
from ringpose.errors import UsageError
from ringpose.types.options import Method
from ringpose.types.plausible import RADIUS_SD_M, RING_RADIUS_M

if TYPE_CHECKING:
    from ringpose.types.pose import KnownRadii, Ring

AUTO = "auto"
"""Value of --ring for which each shot selects the ring of the catalogue."""

DEFAULT_SD_M = 0.0005
"""Default standard deviation of a given radius: edges are chamfered or rounded by about as much."""

MAX_SD = 0.2
"""Upper bound of its standard deviation, relative to the radius."""

RadiusOuter = Annotated[
    float | None, typer.Option("--radius-outer", metavar="M", help="Radius of the outer edge in metres, if known.")
]
RadiusInner = Annotated[
    float | None, typer.Option("--radius-inner", metavar="M", help="Radius of the inner edge in metres, if known.")
]


@dataclass(frozen=True, slots=True)
class RingOptions:
    """What the user states about the ring; None for an option that is not given."""

    PURPOSE: ClassVar = KNOWN_RING

    radius_outer: RadiusOuter = None
    radius_inner: RadiusInner = None
    radius_sd: Annotated[
        float | None,
        typer.Option("--radius-sd", metavar="M", help="Standard deviation of the given radii; default: 0.0005."),
    ] = None
    ring: Annotated[
        str | None, typer.Option("--ring", metavar="NAME", help="A ring of the catalogue; auto: whichever fits.")
    ] = None
    rings: Annotated[
        Path | None, typer.Option("--rings", metavar="FILE", help="A catalogue of your own, for --ring.")
    ] = None


def known_ring(
    options: RingOptions, method: Method, ring_tolerance_m: float | None = None
) -> "KnownRadii | Sequence[Ring] | None":
    """The radii, or the catalogue that the ring belongs to; None if no option is given.

    A given tolerance replaces the tolerances of the catalogue.
    """
    if method is not Method.ML and options != RingOptions():
        raise UsageError("--method", f"{method.value} does not use the ring's radii", "use --method ml")
    _check(options)
    if options.ring is not None:
        return _of_catalogue(options.ring, options.rings, keep_tolerance=ring_tolerance_m is None)
    if options.radius_outer is None and options.radius_inner is None:
        return None
    import numpy as np

    from ringpose.types.pose import KnownRadii

    radii = [np.nan if radius_m is None else radius_m for radius_m in (options.radius_inner, options.radius_outer)]
    sd_m = DEFAULT_SD_M if options.radius_sd is None else options.radius_sd
    return KnownRadii(radius_m=np.array(radii), sd_m=np.full(2, sd_m))


def _check(options: RingOptions) -> None:
    radii = (options.radius_outer, options.radius_inner)
    if options.rings is not None and options.ring is None:
        raise UsageError("--rings", "a catalogue needs --ring", "give --ring NAME or --ring auto")
    if options.ring is not None and radii != (None, None):
        raise UsageError("--ring", "the catalogue gives the radii", "leave out --radius-outer and --radius-inner")
    if options.radius_sd is not None and radii == (None, None):
        raise UsageError("--radius-sd", "needs a radius", "give --radius-outer or --radius-inner")
    for option, radius_m in zip(("--radius-outer", "--radius-inner"), radii, strict=True):
        check_plausible(option, radius_m, RING_RADIUS_M)
    if options.radius_sd is not None:
        smallest_m = min(radius_m for radius_m in radii if radius_m is not None)
        check_plausible("--radius-sd", options.radius_sd, replace(RADIUS_SD_M, highest=MAX_SD * smallest_m))
    if None not in radii and not radii[1] < radii[0]:  # type: ignore[operator]
        raise UsageError("--radius-inner", "is not smaller than --radius-outer", "exchange them")


def _of_catalogue(name: str, path: Path | None, *, keep_tolerance: bool) -> "KnownRadii | Sequence[Ring]":
    from ringpose.files.rings import SHIPPED, read_rings
    from ringpose.files.schema import hint

    rings = read_rings(path or SHIPPED)
    if not keep_tolerance:
        rings = tuple(replace(ring, tolerance_m=None) for ring in rings)
    if name == AUTO:
        return rings
    for ring in rings:
        if ring.name == name:
            return ring.known_radii
    names = [ring.name for ring in rings]
    raise UsageError("--ring", f"{name!r} is not in the catalogue", hint(name, names) or f"it has {', '.join(names)}")
