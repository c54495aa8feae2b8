"""Lasers that the shots name and never show: burnt out, wired to another channel, or beside the board."""

from collections.abc import Sequence

from ringpose.errors import DataError
from ringpose.types.calibration import StripeView


def refuse_unlit(views: Sequence[StripeView], names: Sequence[str]) -> None:
    """Refuse views none of which shows a certain laser, with what their frames say of it."""
    if any(view.unlabelled_px for view in views):
        return
    unseen = [laser for laser in range(len(names)) if not any(len(view.stripes_px[laser]) for view in views)]
    if not unseen:
        return
    lit = [laser for laser in unseen if any(laser in view.lit for view in views)]
    if len(unseen) == len(names):
        raise DataError("calibrate-planes", *_nothing_told(views, names))
    if lit:
        shots = sum(any(laser in view.lit for laser in lit) for view in views)
        found = f"no stripe on the board in any of the {shots} shots whose frames have it on"
        remedy = "see whether it is lit, wired to its channel, and crosses the board"
        raise DataError(_place(lit, names), found, remedy)
    remedy = "light it in the shots (capture --sequence), or leave it out of --laser-names"
    raise DataError(_place(unseen, names), "on in no frame of any shot", remedy)


def _nothing_told(views: Sequence[StripeView], names: Sequence[str]) -> tuple[str, str]:
    """Finding and remedy where no stripe could be given to a laser."""
    most, several = max((view.most_stripes for view in views), default=0), len(names)
    if 0 < most < several:
        lasers = ", ".join(names)
        found = f"no frame shows more than {most} stripe{'s' * (most > 1)} on the board, there are {several} lasers"
        return f"{found} ({lasers})", "see which laser is not lit or misses the board, or name fewer (--laser-names)"
    remedy = "see that the lasers are lit and cross the board; --overlay shows what was looked at"
    return "no shot shows a stripe on the board", remedy


def _place(lasers: Sequence[int], names: Sequence[str]) -> str:
    return f"laser{'s' * (len(lasers) > 1)} " + ", ".join(f'"{names[laser]}"' for laser in lasers)
