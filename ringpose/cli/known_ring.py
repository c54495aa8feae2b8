"""What the user says about the ring's size."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, NamedTuple

import typer

from ringpose.errors import UsageError
from ringpose.types.options import Method

if TYPE_CHECKING:
    from ringpose.types.ring import KnownRadii, Ring

AUTO = "auto"
"""The name that leaves the choice to the shots."""

DEFAULT_SD_M = 0.0005
"""Standard deviation of a radius that was said: edges are chamfered or rounded by about as much."""

MAX_LENGTH_M = 5.0
"""No ring has a larger radius."""

MIN_SD_M = 1e-6
"""Nobody measures a ring so well; less only spoils the arithmetic."""

MAX_SD = 0.2
"""Share of the radius; who knows less of it knows nothing."""

RadiusOuter = Annotated[
    float | None, typer.Option("--radius-outer", metavar="M", help="Radius of the outer edge in metres, if known.")
]
RadiusInner = Annotated[
    float | None, typer.Option("--radius-inner", metavar="M", help="Radius of the inner edge in metres, if known.")
]
RadiusSd = Annotated[
    float | None,
    typer.Option("--radius-sd", metavar="M", help="Standard deviation of the radii that were said; 0.0005 if not."),
]
RingName = Annotated[
    str | None, typer.Option("--ring", metavar="NAME", help="A ring of the catalogue; auto: whichever fits.")
]
RingsFile = Annotated[Path | None, typer.Option("--rings", metavar="FILE", help="A catalogue of your own, for --ring.")]


class RingOptions(NamedTuple):
    """The options as given."""

    radius_outer_m: float | None = None
    radius_inner_m: float | None = None
    radius_sd_m: float | None = None
    ring: str | None = None
    rings: Path | None = None


def known_ring(said: RingOptions, method: Method) -> "KnownRadii | Sequence[Ring] | None":
    """The radii, or the catalogue of which it may be one; None if nothing was said."""
    if method is not Method.ML and said != RingOptions():
        raise UsageError("--method", f"{method.value} has no use for what is known of the ring", "use --method ml")
    _refuse_contradictions(said)
    if said.ring is not None:
        return _of_catalogue(said.ring, said.rings)
    if said.radius_outer_m is None and said.radius_inner_m is None:
        return None
    import numpy as np

    from ringpose.types.ring import KnownRadii

    radii = [np.nan if radius_m is None else radius_m for radius_m in (said.radius_inner_m, said.radius_outer_m)]
    sd_m = DEFAULT_SD_M if said.radius_sd_m is None else said.radius_sd_m
    return KnownRadii(radius_m=np.array(radii), sd_m=np.full(2, sd_m))


def _refuse_contradictions(said: RingOptions) -> None:
    radii = (said.radius_outer_m, said.radius_inner_m)
    if said.rings is not None and said.ring is None:
        raise UsageError("--rings", "a catalogue needs --ring", "give --ring NAME or --ring auto")
    if said.ring is not None and radii != (None, None):
        raise UsageError("--ring", "the catalogue says the radii", "leave out --radius-outer and --radius-inner")
    if said.radius_sd_m is not None and radii == (None, None):
        raise UsageError("--radius-sd", "there is no radius", "give --radius-outer or --radius-inner")
    for option, radius_m in zip(("--radius-outer", "--radius-inner"), radii, strict=True):
        if radius_m is not None and not 0 < radius_m < MAX_LENGTH_M:
            raise UsageError(option, f"{radius_m:g} is no radius in metres that a ring has", _in_metres(radius_m))
    smallest_m = min((radius_m for radius_m in radii if radius_m is not None), default=MAX_LENGTH_M)
    if said.radius_sd_m is not None and not MIN_SD_M <= said.radius_sd_m < MAX_SD * smallest_m:
        found = f"{said.radius_sd_m:g} is no standard deviation in metres of a radius that is known"
        raise UsageError("--radius-sd", found, _in_metres(said.radius_sd_m))
    if None not in radii and not radii[1] < radii[0]:  # type: ignore[operator]
        raise UsageError("--radius-inner", "is not smaller than --radius-outer", "exchange them")


def _in_metres(value: float) -> str:
    """What somebody who thinks in millimetres should have given."""
    return f"give metres: {value / 1000:g}" if 0 < value < 1000 * MAX_LENGTH_M else "give metres"


def _of_catalogue(name: str, path: Path | None) -> "KnownRadii | Sequence[Ring]":
    from ringpose.files.rings import SHIPPED, read_rings
    from ringpose.files.schema import hint

    rings = read_rings(path or SHIPPED)
    if name == AUTO:
        return rings
    for ring in rings:
        if ring.name == name:
            return ring.known_radii
    names = [ring.name for ring in rings]
    raise UsageError("--ring", f"{name!r} is not in the catalogue", hint(name, names) or f"it has {', '.join(names)}")
