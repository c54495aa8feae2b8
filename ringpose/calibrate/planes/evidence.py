"""Selection of views and stripes for the calibration: outliers are left out, each with the reason.

Stages: views whose corners miss the board; lasers that no shot shows (burnt out, wired to another channel, beside the
board); shots with exchanged lasers; assignment of unlabelled stripes; mirrored board poses; stripes beside the plane
of the other views.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ringpose.calibrate.planes.plane_fit import MAX_CONDITION, FittedPlane, Points, light_plane, outlying_views
from ringpose.calibrate.planes.stripes.extraction import triangulated
from ringpose.calibrate.planes.stripes.labels import (
    check_order,
    exchanged_lasers,
    labelled_by_order,
    labelled_by_planes,
)
from ringpose.errors import DataError
from ringpose.types.board import BoardPose
from ringpose.types.calibration import StripeView
from ringpose.types.options import PlanesMethod
from ringpose.types.rig import Camera

OUTLIER_FACTOR = 4.0
"""A view is left out if its corners' rms exceeds the median of the views by this factor, and OUTLIER_FLOOR_PX."""

OUTLIER_FLOOR_PX = 0.5
"""Rms of a view's corners up to which it is never left out."""

MAX_MEDIAN_PX = 5.0
"""Median rms above which camera or board file are wrong: a focal length wrong by 10 % causes 2."""

Remark = tuple[str, str]
"""A view's name, and what was left out of it or is missing, and why."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class StripeEvidence:
    """Input of the plane fit: the stripes on the boards without rejected ones, and board poses from corners alone."""

    names: tuple[str, ...]
    """Names of the lasers."""
    views: tuple[StripeView, ...]
    poses: tuple[BoardPose, ...]
    camera: Camera

    def points(self, laser: int) -> list[Points]:
        """Stripe centres of one laser by view, triangulated with the boards, in the camera frame."""
        return [
            triangulated(view.stripes_px[laser], pose, self.camera)
            for view, pose in zip(self.views, self.poses, strict=True)
        ]

    @property
    def any_beside_print(self) -> bool:
        """Whether a stripe runs over the sheet beside the print of its board."""
        return any(
            bool(view.beside_print(points, pose).any())
            for laser in range(len(self.names))
            for view, pose, points in zip(self.views, self.poses, self.points(laser), strict=True)
        )

    def only(self, kept: Sequence[int]) -> "StripeEvidence":
        """The evidence of some of the views."""
        views = tuple(self.views[index] for index in kept)
        return replace(self, views=views, poses=tuple(self.poses[index] for index in kept))

    def without_stripe(self, laser: int, view: int) -> "StripeEvidence":
        """The evidence without one laser's stripe in one view."""
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
    """The usable views and stripes, remarks on what was left out, and the views that contradict the others.

    `poses` are the candidates for each board: the better one first, then the mirrored one where the corners leave both
    possible.
    """
    kept, remarks = _inlier_boards(views, [each[0] for each in poses])
    evidence = StripeEvidence(
        names=names,
        views=tuple(views[index] for index in kept),
        poses=tuple(poses[index][0] for index in kept),
        camera=camera,
    )
    _check_all_lasers_seen(evidence.views, names)
    points = [evidence.points(laser) for laser in range(len(names))]
    exchanged = exchanged_lasers(points, names, [view.board.name for view in evidence.views])
    contradicting = [(evidence.views[index].board.name, message) for index, message in exchanged.items()]
    right = [index for index in range(len(kept)) if index not in exchanged]
    evidence = _labelled(evidence.only(right), order)
    evidence = _unmirrored(evidence, [poses[kept[index]] for index in right])
    remarks += _missing(evidence)
    evidence, outlying, inconsistent = _without_outlying_stripes(evidence)
    return evidence, remarks + outlying, contradicting + inconsistent


def _inlier_boards(views: Sequence[StripeView], poses: Sequence[BoardPose]) -> tuple[list[int], list[Remark]]:
    """Indices of the views whose corners fit the board, and remarks on the others."""
    if not views:
        remedy = "give shots of the board at two or more distances, 50 mm or more apart"
        raise DataError("calibrate-planes", "no view of the board", remedy)
    rms_px = np.array([pose.residual_rms_px for pose in poses])
    median_px = float(np.median(rms_px))
    if median_px > MAX_MEDIAN_PX:
        finding = f"the corners miss the boards by {median_px:.1f} px rms (median of {len(rms_px)} views)"
        remedy = "give the file of the camera that took these shots, its lens unturned; measure the board's sizes"
        raise DataError("calibrate-planes", finding, remedy)
    inlier = rms_px <= max(OUTLIER_FACTOR * median_px, OUTLIER_FLOOR_PX)
    remarks = [
        (
            pose.name,
            f"left out: its corners miss the board by {pose.residual_rms_px:.2f} px rms, the median is {median_px:.2f}",
        )
        for pose, kept in zip(poses, inlier, strict=True)
        if not kept
    ]
    return np.flatnonzero(inlier).tolist(), remarks


def _check_all_lasers_seen(views: Sequence[StripeView], names: Sequence[str]) -> None:
    """Raise DataError if none of the views shows a certain laser, with the reason that its frames suggest."""
    if any(view.unlabelled_px for view in views):
        return
    unseen = [laser for laser in range(len(names)) if not any(len(view.stripes_px[laser]) for view in views)]
    if not unseen:
        return
    if len(unseen) == len(names):
        most = max((view.max_stripes for view in views), default=0)
        finding = (
            f"no frame shows more than {most} stripes on the board, there are {len(names)} lasers: {', '.join(names)}"
        )
        remedy = "see by --overlay which laser is not lit or misses the board, or name fewer (--laser-names)"
        raise DataError("calibrate-planes", finding, remedy)
    lit = [laser for laser in unseen if any(laser in view.lit for view in views)]
    lasers = lit or unseen
    location = f"laser{'s' * (len(lasers) > 1)} " + ", ".join(f'"{names[laser]}"' for laser in lasers)
    if lit:
        shots = sum(any(laser in view.lit for laser in lit) for view in views)
        finding = f"no stripe on the board in any of the {shots} shots whose frames have it on"
        raise DataError(location, finding, "see whether it is lit, wired to its channel, and crosses the board")
    remedy = "light it in the shots (capture --sequence), or leave it out of --laser-names"
    raise DataError(location, "on in no frame of any shot", remedy)


def _labelled(evidence: StripeEvidence, order: tuple[int, ...] | None) -> StripeEvidence:
    """Unlabelled stripes assigned to lasers: by the given order, or by the planes of the labelled stripes."""
    if order is not None:
        check_order(evidence.views, order, evidence.names)
    if not any(view.unlabelled_px for view in evidence.views):
        return evidence
    if order is not None:
        return replace(evidence, views=tuple(labelled_by_order(view, order) for view in evidence.views))
    planes = []
    for name, plane in zip(evidence.names, _planes_of(evidence), strict=True):
        if plane is None:
            raise DataError(
                f'laser "{name}"',
                "its stripe is not identified: too few shots have a frame with it alone on",
                "capture with --sequence off,1,2,3, or give --laser-order",
            )
        planes.append((plane.normal, plane.distance_m))
    labelled = [
        labelled_by_planes(view, [triangulated(px, pose, evidence.camera) for px in view.unlabelled_px], planes)
        for view, pose in zip(evidence.views, evidence.poses, strict=True)
    ]
    return replace(evidence, views=tuple(labelled))


def _unmirrored(evidence: StripeEvidence, poses: Sequence[Sequence[BoardPose]]) -> StripeEvidence:
    """The evidence with one pose for each board: of two possible ones, the pose that fits the light planes better.

    The pose is chosen whose stripes lie closer to the planes of the unambiguous boards.
    """
    unambiguous = [index for index, candidates in enumerate(poses) if len(candidates) == 1]
    if len(unambiguous) == len(poses) or len(unambiguous) < 2:
        return evidence
    planes = _planes_of(evidence.only(unambiguous))
    chosen = []
    for view, candidates in zip(evidence.views, poses, strict=True):
        sums_m2 = [_sum_of_squares_m2(view, pose, evidence.camera, planes) for pose in candidates]
        chosen.append(candidates[int(np.argmin(sums_m2))])
    return replace(evidence, poses=tuple(chosen))


def _planes_of(evidence: StripeEvidence) -> list[FittedPlane | None]:
    """Each laser's plane fitted to all views; None if they do not determine it."""
    points = [np.concatenate(evidence.points(laser)) for laser in range(len(evidence.names))]
    planes = [light_plane(own, PlanesMethod.TOTAL_LEAST_SQUARES) if len(own) > 2 else None for own in points]
    return [plane if plane is not None and plane.condition <= MAX_CONDITION else None for plane in planes]


def _sum_of_squares_m2(
    view: StripeView, pose: BoardPose, camera: Camera, planes: Sequence[FittedPlane | None]
) -> float:
    """Sum over the stripes of the mean square distance from their planes, for a given board pose."""
    total = 0.0
    for points_px, plane in zip(view.stripes_px, planes, strict=True):
        if plane is not None and len(points_px):
            distances_m = triangulated(points_px, pose, camera) @ plane.normal - plane.distance_m
            total += float(np.mean(distances_m**2))
    return total


def _without_outlying_stripes(evidence: StripeEvidence) -> tuple[StripeEvidence, list[Remark], list[Remark]]:
    """The evidence without stripes beside their laser's plane; remarks on these, and on views with no other stripes."""
    outlying = [outlying_views(evidence.points(laser)) for laser in range(len(evidence.names))]
    remarks, inconsistent = [], []
    for index, view in enumerate(evidence.views):
        seen = [laser for laser, px in enumerate(view.stripes_px) if len(px)]
        left_out = [laser for laser in seen if index in outlying[laser]]
        for laser in left_out:
            evidence = evidence.without_stripe(laser, index)
            reason = f"{1e3 * outlying[laser][index]:.2f} mm beside the plane of the other views"
            if len(left_out) < len(seen) or len(seen) == 1:
                remarks.append((view.board.name, f"stripe of {evidence.names[laser]} left out: {reason}"))
        if len(left_out) == len(seen) > 1:
            max_mm = 1e3 * max(outlying[laser][index] for laser in left_out)
            reason = (
                f"its stripes lie up to {max_mm:.3g} mm beside the planes of the other shots; left out: was the camera "
                "or a laser moved, the image turned, or is it another rig's?"
            )
            inconsistent.append((view.board.name, reason))
    return evidence, remarks, inconsistent


def _missing(evidence: StripeEvidence) -> list[Remark]:
    """Remarks on stripes that the views lack, except of lasers whose light passes beside the board."""
    planes = _planes_of(evidence)
    remarks = []
    for view, pose in zip(evidence.views, evidence.poses, strict=True):
        missing = [
            name
            for name, px, plane in zip(evidence.names, view.stripes_px, planes, strict=True)
            if not len(px) and (plane is None or _crosses_board(plane, view, pose))
        ]
        if missing:
            reasons = "; ".join(view.remarks) or "none on the board"
            remarks.append((view.board.name, f"no stripe of {', '.join(missing)}: {reasons}"))
    return remarks


def _crosses_board(plane: FittedPlane, view: StripeView, pose: BoardPose) -> bool:
    """Whether a light plane has corners of the board on both sides."""
    points_m = view.board.points_board_m @ pose.rotation.T + pose.translation_m
    height_m = points_m @ plane.normal - plane.distance_m
    return bool(height_m.min() <= 0 <= height_m.max())
