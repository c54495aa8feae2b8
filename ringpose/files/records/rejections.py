"""The key `rejected` of pose lines and detections: measurements that contradict the others and were not used."""

import math
from typing import Any, cast

from ringpose.files.schema import Fields
from ringpose.types.arrays import EDGES
from ringpose.types.detection import Rejection

KINDS = ("point", "stripe", "edge", "assignment", "radius")


def rejections_in(fields: Fields) -> tuple[Rejection, ...]:
    """The rejections of a record; kinds that this version does not support are left out. Empty without the key."""
    if not fields.has("rejected"):
        return ()
    return tuple(
        Rejection(
            what=cast(Any, each.text("what")),
            laser=each.optional("laser", each.text),
            edge=cast(Any, each.choice("edge", EDGES)) if each.has("edge") else None,
            chi2=each.number("chi2", missing=math.nan),
        )
        for each in fields.each("rejected")
        if each.text("what") in KINDS
    )
