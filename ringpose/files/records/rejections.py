"""The key `rejected` of pose lines and detections: measurements that contradict the others and were not used."""

import math
from typing import Any, cast

from ringpose.files.schema import Fields
from ringpose.types.arrays import EDGES
from ringpose.types.detection import Rejection

KINDS = ("point", "stripe", "edge", "assignment", "radius")


def rejection_record(rejection: Rejection) -> dict[str, Any]:
    """The mapping that `rejections_in` reads."""
    return {"what": rejection.what, "laser": rejection.laser, "edge": rejection.edge, "chi2": rejection.chi2}


def rejections_in(fields: Fields) -> tuple[Rejection, ...]:
    """The rejections of a record, without those of a kind that this version does not know; none without the key."""
    if not fields.has("rejected"):
        return ()
    return tuple(
        Rejection(
            what=cast(Any, each.text("what")),
            laser=each.text("laser") if each.has("laser") else None,
            edge=cast(Any, each.choice("edge", EDGES)) if each.has("edge") else None,
            chi2=each.number("chi2") if each.has("chi2") else math.nan,
        )
        for each in fields.each("rejected")
        if each.text("what") in KINDS
    )
