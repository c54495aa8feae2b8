"""What the next frames should show of a tracked ring: the stripes on its face, and how well they are predicted."""

from dataclasses import replace

import numpy as np

from ringpose.detect.edge_search import PredictedRing
from ringpose.estimate.visibility import break_point_sigmas_px
from ringpose.geometry.camera_motion import CameraMotion
from ringpose.geometry.rays import project, undistorted_pixels
from ringpose.geometry.ring import STEP, RingArcs, edge_points, predicted_break_points
from ringpose.optics.feature_errors import CUT_OFF_PX
from ringpose.track.explanations import Track
from ringpose.track.filters import mixed, predict
from ringpose.track.states import RingStates, predict_states, retract
from ringpose.types.arrays import Array, Float64
from ringpose.types.detection import BreakPoints
from ringpose.types.rig import Rig

MAX_ACROSS_PX, MAX_ALONG_PX = 6.0, 15.0
"""Largest standard deviations of a prediction across and along a stripe: a quarter of a search window's margins."""

LABELLED_FROM = 5.0
"""Distance of neighbouring stripes, in standard deviations of their prediction, from which it assigns the lasers."""

SHOWN_M = 0.2
"""Length of the face to both sides of the place seen whose motion in the image counts as that of the background."""


def predicted_ring(track: Track, stamp_s: float, camera: CameraMotion | None = None) -> PredictedRing | None:
    """The ring of the likeliest explanation in the camera frame; None if there is no track.

    `camera` is the motion of the camera, for a track in the base frame; also None if the robot's poses do not cover the
    instant.
    """
    if not track.banks:
        return None
    at = predict(track.likeliest.probable, stamp_s)
    mean, covariance = mixed(at)
    arcs = _arcs_of(retract(at.chart, mean[None]), stamp_s, camera)
    return None if arcs is None else PredictedRing(arcs=arcs, covariance=covariance[: len(STEP), : len(STEP)])


def _arcs_of(state: RingStates, stamp_s: float, camera: CameraMotion | None) -> RingArcs | None:
    """The ring of a single state in the camera frame."""
    origin, axes = state.origin[0], state.axes[0]
    if camera is not None:
        where = camera.at(stamp_s)
        if where is None:
            return None
        origin, axes = (origin - where.origin_m) @ where.rotation, axes @ where.rotation
    return RingArcs(
        origin=origin, axes=axes, curvature=float(state.curvature[0]), half_band_m=float(state.half_band_m[0])
    )


def predicted_stripes(rings: list[PredictedRing], rig: Rig) -> BreakPoints | None:
    """The stripes of the lasers, each on the ring at the time of its own frame (`rings`); None if one is too uncertain.

    A stripe is in view if one of its ends is; others are NaN. `labelled` of the result: whether the stripes are so far
    apart that a measured one can be assigned to its laser.
    """
    if rig.stripes_along_columns:
        from ringpose.geometry.quarter_turn import rig_along_rows, to_columns, to_rows  # for few rigs

        turn = to_rows(rig.camera)
        turned = [PredictedRing(arcs=turn.arcs(ring.arcs), covariance=ring.covariance) for ring in rings]
        predicted = predicted_stripes(turned, rig_along_rows(rig))
        return None if predicted is None else to_columns(rig.camera).break_points(predicted)
    points = _stripes_on_arc(rings, rig, [ring.arcs for ring in rings])
    if points is None:
        return None
    beyond = _stripes_on_arc(rings, rig, [ring.arcs.at_opposite_arc() for ring in rings])
    return replace(points, opposite=beyond)


def _stripes_on_arc(rings: list[PredictedRing], rig: Rig, arcs: list[RingArcs]) -> BreakPoints | None:
    """The stripes on the arc of each laser's ring at which it is described by `arcs`; None as `predicted_stripes`."""
    camera, count = rig.camera, len(rings)
    points_m, sigma_px = np.full((count, 2, 3), np.nan), np.full((count, 2, 2), np.nan)
    with np.errstate(all="ignore"):  # a plane that misses the ring has NaN
        for laser, ring in enumerate(rings):
            of_all_m = predicted_break_points(arcs[laser], rig.lasers.normal, rig.lasers.distance_m)
            points_m[laser] = of_all_m[laser]
            sigma_px[laser] = break_point_sigmas_px(ring.arcs, ring.covariance, of_all_m, rig)[laser]
        points_m[(points_m[..., 2] <= 0.0).any(axis=1)] = np.nan  # behind the camera
        position_px = project(points_m, camera)
        size_px = np.array([camera.image_width, camera.image_height]) - 1.0
    inside = np.asarray(((position_px > CUT_OFF_PX) & (position_px < size_px - CUT_OFF_PX)).all(axis=-1))
    in_view = np.asarray(inside.any(axis=1))
    position_px = np.where(in_view[:, None, None], position_px, np.nan)
    sigma_px = np.where(in_view[:, None, None], sigma_px, np.nan)
    if not in_view.any() or not (sigma_px[in_view] < [MAX_ALONG_PX, MAX_ACROSS_PX]).all():
        return None
    left_first = position_px[:, 0, 0] <= position_px[:, 1, 0]
    undistorted_px = undistorted_pixels(position_px, camera)
    left_to_right_px = np.where(left_first[:, None, None], undistorted_px, undistorted_px[:, ::-1])
    covariance_px2 = np.zeros((count, 2, 2, 2))
    covariance_px2[..., [0, 1], [0, 1]] = sigma_px**2
    return BreakPoints(
        position_px=np.where(inside[..., None], position_px, np.nan),
        covariance_px2=np.where(inside[..., None, None], covariance_px2, np.nan),
        flags=np.zeros((count, 2), dtype=np.int64),
        face_start_undistorted_px=left_to_right_px[:, 0],
        face_end_undistorted_px=left_to_right_px[:, 1],
        face_sigma_px=sigma_px[..., 1],
        labelled=_are_apart(position_px[in_view], sigma_px[in_view, :, 1].max(axis=1)),
    )


def _are_apart(ends_px: Float64[Array, "stripe end=2 xy=2"], sigma_px: Float64[Array, "stripe"]) -> bool:
    """Whether the stripes, which run along the image rows, are farther apart than `LABELLED_FROM` sigmas."""
    slope = (ends_px[:, 1, 1] - ends_px[:, 0, 1]) / (ends_px[:, 1, 0] - ends_px[:, 0, 0])
    x, y = ends_px[..., 0].T, ends_px[:, 0, 1]
    # distance of every stripe's line from the ends of every other stripe
    for end in range(2):
        at = y[:, None] + slope[:, None] * (x[end] - x[0][:, None])
        apart_px = np.abs(at - ends_px[:, end, 1])
        np.fill_diagonal(apart_px, np.inf)
        if not (apart_px > LABELLED_FROM * np.maximum(sigma_px[:, None], sigma_px)).all():
            return False
    return True


def motion_px(track: Track, from_s: float, to_s: float, rig: Rig, camera: CameraMotion | None = None) -> float:
    """Largest displacement in the image of the ring's edges between two instants, perpendicular to them, in pixels.

    Edges near the place seen are taken; the result is infinite if the pose of the camera is unknown. The instants may
    also be before the newest measurement.
    """
    bank, shown = track.likeliest.probable, []
    mean, _ = mixed(bank)
    along_m, sign = np.tile(np.linspace(-SHOWN_M, SHOWN_M, 9), 2), np.repeat([-1.0, 1.0], 9)
    for stamp_s in (from_s, to_s):
        arcs = _arcs_of(predict_states(retract(bank.chart, mean[None]), stamp_s - bank.stamp_s), stamp_s, camera)
        if arcs is None:
            return float("inf")
        points_m, outward = edge_points(arcs, along_m, sign)
        shown.append(project(np.stack([points_m, points_m + 1e-3 * outward]), rig.camera))
    across = shown[1][1] - shown[1][0]
    shift_px = ((shown[1][0] - shown[0][0]) * across).sum(axis=1) / np.linalg.norm(across, axis=1)
    return float(np.nanmax(np.abs(shift_px), initial=0.0))
