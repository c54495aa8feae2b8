"""Views of boards with stripes, made ready for the light planes: what does not fit is left out, with the reason.

Lasers that the shots name and never show: burnt out, wired to another channel, or beside the board.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ringpose.calibrate.planes.board_surface import triangulated
from ringpose.calibrate.planes.labels import exchanged_lasers, labelled_by_order, labelled_by_planes, refuse_other_order
from ringpose.calibrate.planes.plane_fit import MAX_CONDITION, Points, condition, outlying_views, robust_plane
from ringpose.errors import DataError
from ringpose.types.arrays import Array, Float64
from ringpose.types.board import BoardPose
from ringpose.types.calibration import StripeView
from ringpose.types.camera import Camera

OUTLIER_FACTOR = 4.0
"""A view whose board fits this many times worse than the median of the views is left out ..."""

OUTLIER_FLOOR_PX = 0.5
"""... if its rms is above this."""

MAX_USUAL_PX = 5.0
"""If corners of most views miss their boards by more, camera or board are others: a focal length 10 % off makes 2."""

Remark = tuple[str, str]
"""A view's name, and what is to be said of it."""

Plane = tuple[Float64[Array, "3"], float]
"""Unit normal and distance."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class StripeEvidence:
    """Boards where their corners have them, and the stripes on them."""

    names: tuple[str, ...]
    """Of the lasers."""
    views: tuple[StripeView, ...]
    poses: tuple[BoardPose, ...]
    camera: Camera

    def points(self, laser: int) -> list[Points]:
        """One laser's points by view."""
        return [
            triangulated(view.stripes_px[laser], pose, self.camera)
            for view, pose in zip(self.views, self.poses, strict=True)
        ]

    def only(self, kept: Sequence[int]) -> "StripeEvidence":
        """The same of some of the views."""
        views = tuple(self.views[index] for index in kept)
        return replace(self, views=views, poses=tuple(self.poses[index] for index in kept))

    def without_stripe(self, laser: int, view: int) -> "StripeEvidence":
        """The same without one laser's stripe in one view."""
        nothing = (np.empty((0, 2)),)
        kept = self.views[view].stripes_px
        less = replace(self.views[view], stripes_px=kept[:laser] + nothing + kept[laser + 1 :])
        return replace(self, views=(*self.views[:view], less, *self.views[view + 1 :]))


def stripe_evidence(
    views: Sequence[StripeView],
    poses: Sequence[Sequence[BoardPose]],
    camera: Camera,
    names: tuple[str, ...],
    order: tuple[int, ...] | None,
) -> tuple[StripeEvidence, list[Remark], list[Remark]]:
    """The views whose boards fit, their stripes given to lasers, stray stripes left out; and what to remark on them.

    `poses` are those of each board: the likelier one, and the mirrored one where the corners cannot tell. Last come
    the views that were left out because they contradict the others.
    """
    kept, remarks = _good_boards(views, [each[0] for each in poses])
    evidence = StripeEvidence(
        names=names,
        views=tuple(views[index] for index in kept),
        poses=tuple(poses[index][0] for index in kept),
        camera=camera,
    )
    refuse_unlit(evidence.views, names)
    wrong = _exchanged(evidence)
    right = [index for index in range(len(kept)) if index not in wrong]
    contradicting = [(evidence.views[index].board.name, sentence) for index, sentence in wrong.items()]
    evidence = _labelled(evidence.only(right), order)
    evidence = _unmirrored(evidence, [poses[kept[index]] for index in right])
    remarks += _missing(evidence)
    evidence, outlying, stray = _agreeing(evidence)
    return evidence, remarks + outlying, contradicting + stray


def _exchanged(evidence: StripeEvidence) -> dict[int, str]:
    """The views whose frames name other lasers than those of most, and what is wrong with them."""
    points = [evidence.points(laser) for laser in range(len(evidence.names))]
    return exchanged_lasers(points, evidence.names, [view.board.name for view in evidence.views])


def _good_boards(views: Sequence[StripeView], poses: Sequence[BoardPose]) -> tuple[list[int], list[Remark]]:
    """The views whose corners fit the board, and the others with the reason."""
    if not views:
        remedy = "give shots of the board at two or more distances, 50 mm or more apart"
        raise DataError("calibrate-planes", "no view of the board", remedy)
    rms = np.array([pose.residual_rms_px for pose in poses])
    usual = float(np.median(rms))
    if usual > MAX_USUAL_PX:
        found = f"the corners miss the boards by {usual:.1f} px rms (median of {len(rms)} views)"
        remedy = "give the file of the camera that took these shots, its lens unturned; measure the board's sizes"
        raise DataError("calibrate-planes", found, remedy)
    good = rms <= max(OUTLIER_FACTOR * usual, OUTLIER_FLOOR_PX)
    remarks = [
        (pose.name, f"left out: its corners miss the board by {pose.residual_rms_px:.2f} px rms, usual is {usual:.2f}")
        for pose, kept in zip(poses, good, strict=True)
        if not kept
    ]
    return np.flatnonzero(good).tolist(), remarks


def _labelled(evidence: StripeEvidence, order: tuple[int, ...] | None) -> StripeEvidence:
    """All stripes given to lasers: by the order, or by the planes of the labelled stripes."""
    if order is not None:
        refuse_other_order(evidence.views, order, evidence.names)
    if not any(view.unlabelled_px for view in evidence.views):
        return evidence
    if order is not None:
        return replace(evidence, views=tuple(labelled_by_order(view, order) for view in evidence.views))
    planes = _preliminary_planes(evidence)
    labelled = [
        labelled_by_planes(view, [triangulated(px, pose, evidence.camera) for px in view.unlabelled_px], planes)
        for view, pose in zip(evidence.views, evidence.poses, strict=True)
    ]
    return replace(evidence, views=tuple(labelled))


def _preliminary_planes(evidence: StripeEvidence) -> list[Plane]:
    """The planes through the stripes that are labelled already."""
    planes = []
    for laser, name in enumerate(evidence.names):
        points = np.concatenate(evidence.points(laser))
        normal, distance_m, weights = robust_plane(points) if len(points) else (np.zeros(3), 0.0, np.zeros(0))
        if not len(points) or condition(points, weights) > MAX_CONDITION:
            raise DataError(
                f'laser "{name}"',
                "which stripe is its is not known: too few shots have a frame with it alone on",
                "capture with --sequence off,1,2,3, or give --laser-order",
            )
        planes.append((normal, distance_m))
    return planes


def _unmirrored(evidence: StripeEvidence, poses: Sequence[Sequence[BoardPose]]) -> StripeEvidence:
    """Boards that may be mirrored stand where their stripes lie nearer to the planes of the other boards."""
    sure = [index for index, each in enumerate(poses) if len(each) == 1]
    if len(sure) == len(poses) or len(sure) < 2:
        return evidence
    planes = _planes_of(evidence, sure)
    chosen = [
        min(each, key=lambda pose, view=view: _misfit_m2(view, pose, evidence.camera, planes))  # type: ignore[misc]
        for view, each in zip(evidence.views, poses, strict=True)
    ]
    return replace(evidence, poses=tuple(chosen))


def _planes_of(evidence: StripeEvidence, chosen: Sequence[int]) -> list[Plane | None]:
    """Of each laser by some of the views; None where those leave it open."""
    planes: list[Plane | None] = []
    for laser in range(len(evidence.names)):
        points = evidence.points(laser)
        every = np.concatenate([points[index] for index in chosen])
        if len(every) < 3 or condition(every, np.ones(len(every))) > MAX_CONDITION:
            planes.append(None)
        else:
            planes.append(robust_plane(every)[:2])
    return planes


def _misfit_m2(view: StripeView, pose: BoardPose, camera: Camera, planes: Sequence[Plane | None]) -> float:
    """Sum over the stripes of the mean square distance from their planes, the board being at a pose."""
    total = 0.0
    for points_px, plane in zip(view.stripes_px, planes, strict=True):
        if plane is not None and len(points_px):
            normal, distance_m = plane
            total += float(np.mean((triangulated(points_px, pose, camera) @ normal - distance_m) ** 2))
    return total


def _agreeing(evidence: StripeEvidence) -> tuple[StripeEvidence, list[Remark], list[Remark]]:
    """The views without those stripes that lie beside their laser's plane; which these are; and whole views that do."""
    outlying = [outlying_views(evidence.points(laser)) for laser in range(len(evidence.names))]
    remarks, stray = [], []
    for index, view in enumerate(evidence.views):
        seen = [laser for laser, px in enumerate(view.stripes_px) if len(px)]
        off = [laser for laser in seen if index in outlying[laser]]
        for laser in off:
            evidence = evidence.without_stripe(laser, index)
        if len(off) == len(seen) > 1:
            far_m = max(outlying[laser][index] for laser in off)
            stray.append((view.board.name, f"its stripes lie up to {1e3 * far_m:.3g} mm {_STRAY}"))
            continue
        remarks += [
            (view.board.name, f"stripe of {evidence.names[laser]} left out: {_beside(outlying[laser][index])}")
            for laser in off
        ]
    return evidence, remarks, stray


_STRAY = (
    "beside the planes of the other shots; left out: was the camera or a laser moved, the image turned, "
    "or is it another rig's?"
)


def _beside(distance_m: float) -> str:
    return f"{1e3 * distance_m:.2f} mm beside the plane of the other views"


def _missing(evidence: StripeEvidence) -> list[Remark]:
    """What the views do not show, but for lasers whose light passes beside the board."""
    planes = _planes_of(evidence, range(len(evidence.views)))
    remarks = []
    for view, pose in zip(evidence.views, evidence.poses, strict=True):
        missing = [
            name
            for name, px, plane in zip(evidence.names, view.stripes_px, planes, strict=True)
            if not len(px) and not _passes_beside(view, pose, plane)
        ]
        if missing:
            found = "; ".join(view.remarks) or "none on the board"
            remarks.append((view.board.name, f"no stripe of {', '.join(missing)}: {found}"))
    return remarks


def _passes_beside(view: StripeView, pose: BoardPose, plane: Plane | None) -> bool:
    """Whether a light plane is known and all corners of the board lie on one side of it."""
    if plane is None:
        return False
    normal, distance_m = plane
    height_m = (view.board.points_board_m @ pose.rotation.T + pose.translation_m) @ normal - distance_m
    return bool(height_m.min() > 0 or height_m.max() < 0)


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
    most, several = max((view.max_stripes for view in views), default=0), len(names)
    if 0 < most < several:
        lasers = ", ".join(names)
        found = f"no frame shows more than {most} stripe{'s' * (most > 1)} on the board, there are {several} lasers"
        return f"{found} ({lasers})", "see which laser is not lit or misses the board, or name fewer (--laser-names)"
    remedy = "see that the lasers are lit and cross the board; --overlay shows what was looked at"
    return "no shot shows a stripe on the board", remedy


def _place(lasers: Sequence[int], names: Sequence[str]) -> str:
    return f"laser{'s' * (len(lasers) > 1)} " + ", ".join(f'"{names[laser]}"' for laser in lasers)
