"""Detections drawn from the ring's model instead of from images, about a hundred a second, for Monte-Carlo studies.

Stripes, break points and visible edges are predicted by `ringpose.geometry.ring` at the time of their frame, on a ring
with the motion, the form and the gaps of the scene. Their errors are those that `ringpose.optics` expects in
images of the scene. The truth may deviate from the assumptions of an estimator in known ways (`Deviations`):
motion, rig, form of the ring, and outliers.
"""

from collections.abc import Iterator
from dataclasses import dataclass, fields, replace
from itertools import islice
from math import sqrt
from typing import NamedTuple

import numpy as np

from ringpose.errors import DataError
from ringpose.geometry.rays import project, rays, undistorted_pixels
from ringpose.geometry.ring import EDGE_SIGN, edge_points
from ringpose.optics.feature_errors import end_covariance_px2, fitted_columns, tilt_sigma_px
from ringpose.simulate.appearance import (
    EDGE_MARGIN_PX,
    Appearance,
    edge_normals_px,
    expected_appearance,
    laser_frames,
)
from ringpose.simulate.break_points import form_deviations, in_gap, inside_image
from ringpose.simulate.pipeline import ring_truth
from ringpose.simulate.placement import READOUT_S, ring_views
from ringpose.simulate.stripe_ends import (
    RunErrors,
    ShotMotion,
    StripeEnds,
    drawn_motion,
    drawn_run_errors,
    stripe_ends,
)
from ringpose.types.arrays import EDGES, Array, Bool, Float64
from ringpose.types.assumptions import MotionPrior
from ringpose.types.detection import (
    BreakPointFlag,
    BreakPoints,
    Detection,
    NoBreakPoints,
    RingEdgePoints,
    joined_edge_points,
)
from ringpose.types.rig import Camera
from ringpose.types.scene import RingView, Scene
from ringpose.types.target import Box, Part, RingForm
from ringpose.types.truth import Truth

_FEATURES, _COMMON, _FAULTS = 2, 3, 4
"""First numbers of the seeds of shots, of their common errors, and of their faults; images have 0 and 1."""

END_PX, GHOST_PX, EDGE_PX = (2.0, 40.0), (3.0, 40.0), (1.5, 10.0)
"""Ranges of displacements by faults, to either side; all are log-uniform, as small ones contradict nothing ..."""

BEHIND_M = (0.003, 0.1)
"""... and so is the distance of a surface behind the face."""

TAIL_FREEDOM, SIGMA_FACTOR = 4.0, 1.3


@dataclass(frozen=True, slots=True, kw_only=True)
class Deviations:
    """What a drawn shot contains that an ideal one does not; nothing but the images' noise by default."""

    noise: bool = True
    """Whether positions have errors; their stated covariances are the same without."""
    rig_errors: bool = False
    """Whether the true rig is drawn from the covariance and the stability of the scene's rig."""
    motion: MotionPrior | None = None
    """Distribution of the velocity of the ring's centre, per axis, and of its two rates across the normal."""
    ring_tolerance_m: float = 0.0
    """Standard deviation of each edge from a circle, and of the face from a plane."""
    displaced_share: float = 0.0
    """Probability that a break point is displaced along its stripe ..."""
    displaced_px: tuple[float, float] = (3.0, 15.0)
    """... and the range of its displacement, to either side."""
    background_share: float = 0.0
    """Probability that a stripe lies on a surface behind the ring, where its shadow looks like the ring's face ..."""
    background_m: tuple[float, float] = (0.02, 0.1)
    """... and the range of that surface's distance behind the face."""
    missing_share: float = 0.0
    """Probability that a stripe is not detected."""
    faults: tuple[str, ...] = ()
    """Of `DRAWN_FAULTS`, in addition."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class DrawnShot:
    """A drawn detection and its truth; `groups` of the truth name the outliers."""

    detection: Detection
    truth: Truth
    common: RunErrors


def drawn_features(
    scene: Scene, deviations: Deviations = Deviations(), count: int | None = None
) -> Iterator[DrawnShot]:
    """Draw a detection for the first `count` views of a scene, or all; rig and form of the ring are drawn once.

    A scene with what only images show (`_reject_what_images_show`) is a `DataError`.
    """
    _reject_what_images_show(scene)
    common = run_errors(scene, np.random.default_rng([_COMMON, scene.seed]), deviations)
    shown: RingView | None = None
    for number, view in enumerate(islice(ring_views(scene), count)):
        rng = np.random.default_rng([_FEATURES, scene.seed, number])
        if shown is None or not looks_like(view, shown):
            shown = view
        stamp_s = scene.start_s + number * scene.period_s
        yield draw_detection(scene, view, rng, deviations, common, stamp_s, expected_appearance(scene, shown))


def _reject_what_images_show(scene: Scene) -> None:
    shown = {
        "lasers.ghost": scene.lasers.ghost is not None,
        "lasers.bow_per_rad": scene.lasers.bow_per_rad != 0.0,
        "rig (bent light planes)": bool(scene.rig.bows),
        "ring.slope_rad": bool(np.ptp(scene.ring.edge_heights_m)),
        "obstacles": bool(scene.obstacles),
        "rig (stripes along columns)": scene.rig.stripes_along_columns,
    }
    for key, given in shown.items():
        if given:
            raise DataError(f"the scene's {key}", "has no model of its features", "render images, without --features")


MAX_CHANGE = 0.01
"""Motion of the ring over its distance, and change of its normal, up to which it looks the same."""


def looks_like(view: RingView, shown: RingView) -> bool:
    """Whether a view of a moving ring is so similar to an earlier one that the errors of its features are the same."""
    if view.path is None or (view.path, view.light) != (shown.path, shown.light):
        return False
    moved_m = np.linalg.norm(view.center_m - shown.center_m)
    turned = np.linalg.norm(view.normal - shown.normal)
    return bool(moved_m < MAX_CHANGE * np.linalg.norm(view.center_m) and turned < MAX_CHANGE)


def run_errors(scene: Scene, rng: np.random.Generator, deviations: Deviations) -> RunErrors:
    """True rig and form of the ring of one run: the scene's form, and what is drawn."""
    drawn = drawn_run_errors(
        scene.rig, rng, ring_tolerance_m=deviations.ring_tolerance_m, with_rig_errors=deviations.rig_errors
    )
    own = scene.ring.form
    if own is None:
        return drawn
    form = RingForm(radial_m=drawn.form.radial_m + own.radial_m, axial_m=drawn.form.axial_m + own.axial_m)
    return drawn._replace(form=form)


# One shot


def draw_detection(
    scene: Scene,
    view: RingView,
    rng: np.random.Generator,
    deviations: Deviations = Deviations(),
    common: RunErrors | None = None,
    stamp_s: float = 0.0,
    appearance: Appearance | None = None,
) -> DrawnShot:
    """The detection in a shot of one view that begins at `stamp_s`, with its truth.

    Without `common`, the common errors are drawn for this shot alone; `appearance` is that of this view or of a similar
    one. Edges have their true names: a detector may exchange inner and outer edge where the stripes hardly show the
    ring's curvature.
    """
    if common is None:
        common = run_errors(scene, rng, deviations)
    lasers = len(scene.rig.lasers.names)
    frames, appearance = laser_frames(scene.sequence, lasers), appearance or expected_appearance(scene, view)
    exposure_s = appearance.exposure_s
    middle_s = exposure_s / 2 + np.arange(len(scene.sequence)) * (exposure_s + READOUT_S)  # since the shot's beginning
    shown_s = np.where(frames.number >= 0, middle_s[frames.number], np.nan)
    first_s = float(middle_s[int(np.argmax(np.array(scene.sequence) > 0))])
    unit = rng.standard_normal(5 + 4 * lasers)  # of motion, then of stripes
    motion, start_s = drawn_motion(view.normal, deviations.motion, unit[:5]), first_s if view.path is None else 0.0
    shot_motion = ShotMotion(scene, view, appearance.arcs, appearance.axes, motion, start_s)
    moving = view.path is not None or deviations.motion is not None
    outliers = _outliers(deviations, rng.uniform(size=(lasers, 7)))
    of_faults = np.random.default_rng([_FAULTS, *unit[:2].view(np.uint64).tolist()])
    outliers, unit = _with_faults(outliers, unit, deviations.faults, appearance.seen, of_faults)

    break_points: BreakPoints | NoBreakPoints = (
        NoBreakPoints.NO_RING if view.target == "body" else NoBreakPoints.NO_STRIPE
    )
    position_px, edges = np.full((lasers, 2, 2), np.nan), None
    if view.target == "ring":
        when_s = np.where(np.isfinite(shown_s), shown_s, first_s)
        stripes = stripe_ends(scene.ring, appearance, common, shot_motion, when_s, outliers.behind_m)
        position_px = stripes.true_px
        if outliers.behind_m.any():
            position_px = stripe_ends(scene.ring, appearance, common, shot_motion, when_s, np.zeros(lasers)).true_px
        seen = np.isfinite(stripes.start_px[:, 0]) & appearance.seen & ~outliers.missing
        if seen.any():
            noise = unit[5:].reshape(lasers, 4) * deviations.noise
            points = _drawn_points(_displaced(stripes, outliers.ghost_px), appearance, noise, outliers.shift_px, seen)
            stamp = np.where(seen, stamp_s + shown_s, np.nan)
            break_points = _as_measured(points, scene.rig.camera, frames.labelled(seen), stamp)
            unit = rng.standard_normal(len(appearance.edges.edge)) * deviations.noise
            edges = _drawn_edges(scene, appearance, common, shot_motion, middle_s, stamp_s, unit, moving=moving)
            edges = _with_wrong_edges(edges, deviations.faults, of_faults)
            beyond = shot_motion._replace(arcs=shot_motion.arcs.at_opposite_arc())
            stripes = stripe_ends(scene.ring, appearance, common, beyond, when_s, outliers.behind_m)
            seen &= np.isfinite(stripes.start_px[:, 0])
            if seen.any():
                noise = rng.standard_normal((lasers, 4)) * deviations.noise
                points = _drawn_points(stripes, appearance, noise, np.zeros((lasers, 2)), seen)
                stamp = np.where(seen, stamp_s + shown_s, np.nan)
                opposite = _as_measured(points, scene.rig.camera, frames.labelled(seen), stamp)
                break_points = replace(break_points, opposite=opposite)
    if scene.gripper and isinstance(break_points, BreakPoints):
        break_points, edges = _beside_gripper(scene, break_points, edges)
    detection = Detection(
        shot=view.name,
        stamp_s=stamp_s + first_s,
        break_points=break_points,
        ring_edges=edges,
        lasers_on=frames.number >= 0,
        still=not moving,
    )
    return DrawnShot(
        detection=detection,
        truth=_truth(scene, view, position_px, first_s, stamp_s, shot_motion, outliers, moving=moving),
        common=common,
    )


class _Outliers(NamedTuple):
    displaced: Bool[Array, "laser edge=2"]
    shift_px: Float64[Array, "laser edge=2"]
    behind_m: Float64[Array, "laser"]
    missing: Bool[Array, "laser"]
    ghost_px: Float64[Array, "laser xy=2"]
    """Displacement of a stripe with its ends."""


def _outliers(deviations: Deviations, picks: Float64[Array, "laser 7"]) -> _Outliers:
    """The outliers of a shot, chosen by the uniform random numbers `picks`."""
    least_px, most_px = deviations.displaced_px
    nearest_m, farthest_m = deviations.background_m
    displaced = picks[:, :2] < deviations.displaced_share
    signed = 2 * picks[:, 2:4] - 1
    shift_px = np.copysign(least_px + (most_px - least_px) * np.abs(signed), signed)
    behind_m = nearest_m + (farthest_m - nearest_m) * picks[:, 5]
    return _Outliers(
        displaced=displaced,
        shift_px=np.where(displaced, shift_px, 0.0),
        behind_m=np.where(picks[:, 4] < deviations.background_share, behind_m, 0.0),
        missing=picks[:, 6] < deviations.missing_share,
        ghost_px=np.zeros((len(picks), 2)),
    )


def _with_faults(
    outliers: _Outliers,
    unit: Float64[Array, "number"],
    faults: tuple[str, ...],
    seen: Bool[Array, "laser"],
    rng: np.random.Generator,
) -> tuple[_Outliers, Float64[Array, "number"]]:
    """The outliers and the standard normal numbers of a shot with faults, each of them at a stripe of its own."""
    if not faults:
        return outliers, unit
    shift_px, behind_m = outliers.shift_px.copy(), outliers.behind_m.copy()
    ghost_px, missing = outliers.ghost_px.copy(), outliers.missing.copy()
    free = rng.permutation(np.flatnonzero(seen)).tolist()
    for fault in (each for each in faults if each in ("end", "ends", "stripe", "ghost", "missing")):
        laser = free.pop() if free else 0
        if fault == "end":
            shift_px[laser, int(rng.integers(2))] = _log_uniform(END_PX, rng)
        elif fault == "ends":
            shift_px[laser] = _log_uniform(END_PX, rng), _log_uniform(END_PX, rng)
        elif fault == "stripe":
            behind_m[laser] = abs(_log_uniform(BEHIND_M, rng))
        elif fault == "ghost":
            ghost_px[laser] = _log_uniform(GHOST_PX, rng), _log_uniform(GHOST_PX, rng)
        else:
            missing[laser] = True
    unit = _with_larger_errors(unit, faults, rng)
    return _Outliers(
        displaced=outliers.displaced | (shift_px != 0.0),
        shift_px=shift_px,
        behind_m=behind_m,
        missing=missing,
        ghost_px=ghost_px,
    ), unit


def _with_larger_errors(
    unit: Float64[Array, "number"], faults: tuple[str, ...], rng: np.random.Generator
) -> Float64[Array, "number"]:
    """The standard normal numbers, those of the features from heavier tails or larger than stated."""
    errors = unit[5:]  # after those of the motion
    if "tails" in faults:
        errors = rng.standard_t(TAIL_FREEDOM, len(errors)) * sqrt((TAIL_FREEDOM - 2.0) / TAIL_FREEDOM)
    if "sigmas" in faults:
        errors = SIGMA_FACTOR * errors
    return np.concatenate([unit[:5], errors])


def _log_uniform(bounds: tuple[float, float], rng: np.random.Generator) -> float:
    """A number whose logarithm is uniform between those of the bounds, with a random sign."""
    return float(np.exp(rng.uniform(*np.log(bounds))) * rng.choice([-1.0, 1.0]))


def _displaced(stripes: StripeEnds, shift_px: Float64[Array, "laser xy=2"]) -> StripeEnds:
    """The stripes displaced in the image, with their ends."""
    return stripes._replace(
        true_px=stripes.true_px + shift_px[:, None],
        start_px=stripes.start_px + shift_px,
        end_px=stripes.end_px + shift_px,
    )


def _with_wrong_edges(
    edges: RingEdgePoints | None, faults: tuple[str, ...], rng: np.random.Generator
) -> RingEdgePoints | None:
    """The visible edges, of which one is displaced or all are unlit, if the faults state so."""
    if edges is None or "unlit" in faults:
        return None
    if "edge" not in faults:
        return edges
    shift_px = np.where(edges.edge == int(rng.integers(2)), _log_uniform(EDGE_PX, rng), 0.0)
    return replace(edges, position_px=edges.position_px + shift_px[:, None] * edges.normal)


# Drawing


def _drawn_points(
    stripes: StripeEnds,
    appearance: Appearance,
    unit: Float64[Array, "laser 4"],
    shift_px: Float64[Array, "laser edge=2"],
    seen: Bool[Array, "laser"],
) -> BreakPoints:
    """Break points and lines with errors made from standard normal numbers `unit`; the lines in distorted pixels.

    `shift_px`: further errors along the stripes.
    """
    lasers, left = np.arange(len(seen)), stripes.edge_at_start
    chord_px = stripes.end_px - stripes.start_px
    columns = chord_px[:, 0]
    fitted = fitted_columns(columns)
    line_sigma_px = np.array(
        [
            np.nan if center is None else center.line_sigma_px(number)
            for center, number in zip(appearance.centers, fitted.tolist(), strict=True)
        ]
    )
    slope_sigma_px = tilt_sigma_px(line_sigma_px, columns / 2, fitted)  # of the ordinates at both ends
    end_sigma_px = np.hypot(line_sigma_px, slope_sigma_px)
    middle_px, tilt_px = line_sigma_px * unit[:, 0], slope_sigma_px * unit[:, 1]
    start_px, end_px = stripes.start_px.copy(), stripes.end_px.copy()
    start_px[:, 1] += middle_px - tilt_px
    end_px[:, 1] += middle_px + tilt_px
    across_px = np.empty((len(seen), 2))
    across_px[lasers, left], across_px[lasers, 1 - left] = middle_px - tilt_px, middle_px + tilt_px

    along_px = appearance.end_sigma_px * unit[:, 2:] + shift_px
    direction = np.stack([np.ones(len(seen)), chord_px[:, 1] / chord_px[:, 0]], axis=1)
    position_px = stripes.true_px + along_px[..., None] * direction[:, None]
    position_px[..., 1] += across_px
    both = np.ones(2)
    covariance_px2 = end_covariance_px2(appearance.end_sigma_px, end_sigma_px[:, None] * both, direction[:, 1:] * both)
    measured = np.isfinite(stripes.true_px[..., 0]) & seen[:, None]
    saturated = np.array([center is not None and center.saturated for center in appearance.centers])
    flags = np.where(measured & saturated[:, None], int(BreakPointFlag.SATURATED), 0)
    flags += np.where(~measured & seen[:, None], int(BreakPointFlag.CLIPPED), 0)
    return BreakPoints(
        position_px=np.where(measured[..., None], position_px, np.nan),
        covariance_px2=np.where(measured[..., None, None], covariance_px2, np.nan),
        flags=flags.astype(np.int64),
        face_start_undistorted_px=np.where(seen[:, None], start_px, np.nan),
        face_end_undistorted_px=np.where(seen[:, None], end_px, np.nan),
        face_sigma_px=np.where(seen, end_sigma_px, np.nan)[:, None] * both,
        labelled=True,
    )


def _drawn_edges(
    scene: Scene,
    appearance: Appearance,
    common: RunErrors,
    shot_motion: ShotMotion,
    middle_s: Float64[Array, "frame"],
    stamp_s: float,
    unit: Float64[Array, "place"],
    *,
    moving: bool,
) -> RingEdgePoints | None:
    """Points of the visible edges with errors made from standard normal numbers `unit`; None if no edge is visible.

    As in the detector, the edges of a moving ring are measured in two frames, else in one. Most errors come from what
    lies beside the edges and are the same in both frames: the stated standard deviations are raised so that two frames
    of a ring at rest determine the ring no better than one.
    """
    numbers = [appearance.edges.frame]
    dark = [number for number, mask in enumerate(scene.sequence) if not mask]
    if dark and moving:
        numbers = sorted({dark[0], dark[-1]})
    visible, camera, drawn = appearance.edges, common.rig.camera, []
    for time_s in middle_s[numbers].tolist():
        arcs, axes = shot_motion.at(time_s)
        place_m, outward = edge_points(arcs, visible.along_m, np.array(EDGE_SIGN)[visible.edge])
        own_m = (place_m - arcs.center) @ axes
        if common.form.any():
            radial_m, axial_m = form_deviations(common.form, own_m, visible.edge)
            place_m = place_m + radial_m[:, None] * outward + axial_m[:, None] * arcs.normal
        position_px = project(place_m, camera)
        shown = inside_image(position_px, EDGE_MARGIN_PX, camera) & ~in_gap(scene.ring, own_m)
        if not shown.any():
            continue
        off_face = np.array(EDGE_SIGN)[visible.edge[shown], None] * outward[shown]
        normal, _ = edge_normals_px(place_m[shown], off_face, arcs, camera)
        drawn.append(
            RingEdgePoints(
                position_px=position_px[shown] + (visible.sigma_px * unit)[shown, None] * normal,
                normal=normal,
                sigma_px=sqrt(len(numbers)) * visible.sigma_px[shown],
                edge=visible.edge[shown],
                stamp_s=np.full(int(shown.sum()), stamp_s + time_s),
            )
        )
    return joined_edge_points(drawn) if drawn else None


def _beside_gripper(
    scene: Scene, points: BreakPoints, edges: RingEdgePoints | None
) -> tuple[BreakPoints | NoBreakPoints, RingEdgePoints | None]:
    """What the gripper leaves of the features: it hides them from the camera, and lies in the light of the lasers.

    A stripe without any end is not seen. Where a stripe on the gripper itself begins, images show another end, which
    the detector has to reject: that is not drawn.
    """
    lasers, camera = scene.rig.lasers, scene.rig.camera
    towards = rays(points.position_px, camera)
    point_m = towards * (lasers.distance_m[:, None] / (towards @ lasers.normal[:, :, None])[..., 0])[..., None]
    ends = _is_between(scene.gripper, np.zeros(3), point_m)
    ends |= _is_between(scene.gripper, lasers.projector_m[:, None], point_m)
    gone = np.asarray((ends | ~points.seen).all(axis=1) & ends.any(axis=1))
    flags = np.where(ends, points.flags | int(BreakPointFlag.OCCLUDED), points.flags)
    left = replace(points.without(ends, gone), flags=flags)
    if edges is not None:
        shown = ~_is_between(scene.gripper, np.zeros(3), FAR_M * rays(edges.position_px, camera))
        edges = RingEdgePoints(**{each.name: getattr(edges, each.name)[shown] for each in fields(edges)})
    return left if left.of_lasers.any() else NoBreakPoints.NO_STRIPE, edges if edges and len(edges.edge) else None


FAR_M = 100.0
"""A distance beyond the ring."""


def _is_between(
    boxes: tuple[Part, ...], from_m: Float64[Array, "*any xyz=3"], to_m: Float64[Array, "*shape xyz=3"]
) -> Bool[Array, "*shape"]:
    """Whether a box is between places and points; false for points that are not known (slabs of the box)."""
    between = np.zeros(to_m.shape[:-1], dtype=np.bool_)
    for box in boxes:
        assert isinstance(box.shape, Box)  # as the scene's reader has them
        start_m = (from_m - box.translation_m) @ box.rotation
        step_m = (to_m - box.translation_m) @ box.rotation - start_m
        with np.errstate(all="ignore"):
            low, high = (box.shape.low_m - start_m) / step_m, (box.shape.high_m - start_m) / step_m
            begin, end = np.minimum(low, high).max(axis=-1), np.maximum(low, high).min(axis=-1)
            between |= (begin <= end) & (end > 0.0) & (begin < 1.0)
    return between


def _as_measured(points: BreakPoints, camera: Camera, labelled: bool, stamp_s: Float64[Array, "laser"]) -> BreakPoints:
    """The break points with their lines undistorted by the calibrated camera, not by the true one."""
    ends_px = np.stack([points.face_start_undistorted_px, points.face_end_undistorted_px])
    straight_px, below_px = undistorted_pixels(np.stack([ends_px, ends_px + np.array([0.0, 1.0])]), camera)
    return replace(
        points,
        face_start_undistorted_px=straight_px[0],
        face_end_undistorted_px=straight_px[1],
        face_sigma_px=points.face_sigma_px * (below_px - straight_px)[..., 1].T,
        labelled=labelled,
        stamp_s=stamp_s,
    )


def _truth(
    scene: Scene,
    view: RingView,
    position_px: Float64[Array, "laser edge=2 xy=2"],
    time_s: float,
    stamp_s: float,
    shot_motion: ShotMotion,
    outliers: _Outliers,
    *,
    moving: bool,
) -> Truth:
    """The truth of a drawn shot; the groups name its outliers."""
    names = scene.rig.lasers.names
    points = [f"{names[laser]}.{EDGES[edge]}" for laser, edge in np.argwhere(outliers.displaced).tolist()]
    wrong = {
        "displaced": ",".join(points),
        "ghost": ",".join(names[laser] for laser in np.flatnonzero(outliers.ghost_px.any(axis=1))),
        "background": ",".join(names[laser] for laser in np.flatnonzero(outliers.behind_m)),
        "missing": ",".join(names[laser] for laser in np.flatnonzero(outliers.missing)),
    }
    center_m, normal = view.center_m, view.normal
    if view.path is not None:
        arcs, _ = shot_motion.at(time_s)
        center_m, normal = arcs.center, arcs.normal
    truth = ring_truth(scene, view, center_m, normal, position_px)
    if truth.expect == "no_target":
        return truth
    truth = replace(truth, groups={**truth.groups, **{key: value for key, value in wrong.items() if value}})
    if not moving:
        return truth
    motion = shot_motion.motion(time_s)
    return replace(
        truth,
        stamp_s=stamp_s + time_s,
        velocity_m_s=motion.velocity_m_s,
        angular_velocity_rad_s=motion.rate_rad_s,
    )
