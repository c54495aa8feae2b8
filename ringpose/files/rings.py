"""Catalogues of rings: their names and the intervals of their inner and outer radii."""

from pathlib import Path

from ringpose.files.schema import Fields
from ringpose.files.yaml import read_yaml
from ringpose.types.plausible import RING_RADIUS_M, RING_TOLERANCE_M
from ringpose.types.pose import Ring

SCHEMA = "rings/1"

SHIPPED = Path(__file__).with_name("rings.yaml")
"""The catalogue in the package, with nominal sizes from the launcher manuals."""

RESERVED = ("auto", "none of these")
"""Words that cannot be the name of a ring, since options and records give them another meaning."""

_KEYS = ("ringpose", "provenance", "rings")
_RING_KEYS = ("name", "radius_inner_m", "radius_outer_m", "nominal", "source", "tolerance_m")


def read_rings(path: Path = SHIPPED) -> tuple[Ring, ...]:
    """The rings of a catalogue in the file's order."""
    fields = read_yaml(path, _KEYS)
    fields.choice("ringpose", (SCHEMA,))
    rings: list[Ring] = []
    for entry in fields.each("rings", _RING_KEYS):
        ring = _ring(entry)
        if ring.name in RESERVED or ring.name in (other.name for other in rings):
            raise entry.problem("name", f"{ring.name!r} is taken", "give each ring a name of its own")
        rings.append(ring)
    if not rings:
        raise fields.problem("rings", "has no ring")
    return tuple(rings)


def _ring(fields: Fields) -> Ring:
    fields.optional("nominal", fields.boolean)  # for the readers of the file: the interval already shows it
    inner, outer = _interval(fields, "radius_inner_m"), _interval(fields, "radius_outer_m")
    if not inner[1] < outer[0]:
        raise fields.problem("radius_inner_m", f"reaches {inner[1]:g}, must end below the outer edge's {outer[0]:g}")
    tolerance_m = fields.quantity("tolerance_m", RING_TOLERANCE_M) if fields.has("tolerance_m") else None
    if tolerance_m is not None and not fields.has("source"):
        raise fields.problem("tolerance_m", "has no source", "add source: the drawing or the measurement it is from")
    return Ring(
        name=fields.text("name"),
        radius_inner_m=inner,
        radius_outer_m=outer,
        source=fields.optional("source", fields.text) or "",
        tolerance_m=tolerance_m,
    )


def _interval(fields: Fields, key: str) -> tuple[float, float]:
    """Lower and upper limit of a radius in metres."""
    start_m, end_m = fields.quantities(key, 2, RING_RADIUS_M).tolist()
    if not start_m < end_m:
        raise fields.problem(key, f"is [{start_m:g}, {end_m:g}], must be two positive radii, the smaller one first")
    return start_m, end_m
