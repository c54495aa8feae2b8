"""Detections drawn from the ring's model instead of from images, about a hundred a second, for Monte-Carlo studies.

Stripes, break points and visible edges are predicted by `ringpose.geometry.ring` at the time of their frame, on a ring
with the motion, the form and the gaps of the scene. Their errors are those that `ringpose.simulate.feature_errors`
expects in images of the scene. The truth may deviate from the assumptions of an estimator in known ways (`Deviations`):
motion, rig, form of the ring, and outliers.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from math import sqrt
from typing import NamedTuple

import numpy as np

from ringpose.geometry.rays import project, undistorted_pixels
from ringpose.geometry.ring import EDGE_SIGN, LIFT, STEP, RingArcs, edge_points, predicted_break_points, rotation_by
from ringpose.geometry.rotations import cross, tilt_basis
from ringpose.simulate.appearance import (
    EDGE_MARGIN_PX,
    Appearance,
    edge_normals_px,
    expected_appearance,
    inside_image,
    laser_frames,
)
from ringpose.simulate.break_points import in_gap
from ringpose.simulate.common_errors import (
    CommonErrors,
    drawn_common_errors,
    form_deviations,
    form_displacement,
)
from ringpose.simulate.feature_errors import COLUMNS_PER_CUT, CUT_CENTRES
from ringpose.simulate.motion import velocities
from ringpose.simulate.placement import READOUT_S, ring_views, target_placement
from ringpose.types.arrays import EDGES, Array, Bool, Float64, Int64
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
from ringpose.types.scene import RingView, Scene, Truth
from ringpose.types.target import RingForm, RingShape

_FEATURES, _COMMON = 2, 3
"""First numbers of the seeds of shots and of their common errors; images have 0 and 1."""


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


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class DrawnShot:
    """A drawn detection and its truth, whose groups name the outliers."""

    detection: Detection
    truth: Truth
    common: CommonErrors


def drawn_features(
    scene: Scene, deviations: Deviations = Deviations(), count: int | None = None
) -> Iterator[DrawnShot]:
    """The first `count` views of a scene, or all, as one run: rig and form of the ring are drawn once."""
    common = common_errors(scene, np.random.default_rng([_COMMON, scene.seed]), deviations)
    shown: RingView | None = None
    for number, view in enumerate(ring_views(scene)[:count]):
        rng = np.random.default_rng([_FEATURES, scene.seed, number])
        if shown is None or not _looks_like(view, shown):
            shown = view
        stamp_s = scene.start_s + number * scene.period_s
        yield draw_detection(scene, view, rng, deviations, common, stamp_s, expected_appearance(scene, shown))


MAX_CHANGE = 0.01
"""Motion of the ring over its distance, and change of its normal, up to which it looks the same."""


def _looks_like(view: RingView, shown: RingView) -> bool:
    """Whether the errors of a moving ring's features are those of an earlier view."""
    if view.path is None or (view.path, view.light) != (shown.path, shown.light):
        return False
    moved_m = np.linalg.norm(view.center_m - shown.center_m)
    turned = np.linalg.norm(view.normal - shown.normal)
    return bool(moved_m < MAX_CHANGE * np.linalg.norm(view.center_m) and turned < MAX_CHANGE)


def common_errors(scene: Scene, rng: np.random.Generator, deviations: Deviations) -> CommonErrors:
    """True rig and form of the ring of one run: the scene's form, and what is drawn."""
    drawn = drawn_common_errors(
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
    common: CommonErrors | None = None,
    stamp_s: float = 0.0,
    appearance: Appearance | None = None,
) -> DrawnShot:
    """The detection in a shot of one view that begins at `stamp_s`, with its truth.

    Without `common` errors they are drawn for this shot alone; `appearance` is that of this view or of one nearby.
    Edges are named as they are: a detector may exchange inner and outer edge where the stripes hardly show the ring's
    curvature.
    """
    if common is None:
        common = common_errors(scene, rng, deviations)
    lasers = len(scene.rig.lasers.names)
    frames, appearance = laser_frames(scene.sequence, lasers), appearance or expected_appearance(scene, view)
    exposure_s = appearance.exposure_s
    middle_s = exposure_s / 2 + np.arange(len(scene.sequence)) * (exposure_s + READOUT_S)  # since the shot's beginning
    shown_s = np.where(frames.number >= 0, middle_s[frames.number], np.nan)
    first_s = float(middle_s[int(np.argmax(np.array(scene.sequence) > 0))])
    unit = rng.standard_normal(5 + 4 * lasers)  # of motion, then of stripes
    motion, start_s = _motion(view.normal, deviations.motion, unit[:5]), first_s if view.path is None else 0.0
    course = _Course(scene, view, appearance.arcs, appearance.axes, motion, start_s)
    moving = view.path is not None or deviations.motion is not None
    outliers = _outliers(deviations, rng.uniform(size=(lasers, 7)))

    found: BreakPoints | NoBreakPoints = NoBreakPoints.NO_RING if view.target == "body" else NoBreakPoints.NO_STRIPE
    position_px, edges = np.full((lasers, 2, 2), np.nan), None
    if view.target == "ring":
        when_s = np.where(np.isfinite(shown_s), shown_s, first_s)
        stripes = _stripes(scene.ring, appearance, common, course, when_s, outliers.behind_m)
        position_px = stripes.true_px
        if outliers.behind_m.any():
            position_px = _stripes(scene.ring, appearance, common, course, when_s, np.zeros(lasers)).true_px
        seen = np.isfinite(stripes.start_px[:, 0]) & appearance.seen & ~outliers.missing
        if seen.any():
            noise = unit[5:].reshape(lasers, 4) * deviations.noise
            points = _drawn_points(stripes, appearance, noise, outliers, seen)
            stamp = np.where(seen, stamp_s + shown_s, np.nan)
            found = _as_measured(points, scene.rig.camera, frames.labelled(seen), stamp)
            unit = rng.standard_normal(len(appearance.edges.edge)) * deviations.noise
            edges = _edges_of_frames(scene, appearance, common, course, middle_s, stamp_s, unit, moving=moving)
    detection = Detection(
        shot=view.name,
        stamp_s=stamp_s + first_s,
        break_points=found,
        ring_edges=edges,
        lasers_on=frames.number >= 0,
        still=not moving,
    )
    return DrawnShot(
        detection=detection,
        truth=_truth(scene, view, position_px, first_s, stamp_s, course, outliers, moving=moving),
        common=common,
    )


class _Motion(NamedTuple):
    velocity_m_s: Float64[Array, "xyz=3"]
    rate_rad_s: Float64[Array, "xyz=3"]


def _motion(normal: Float64[Array, "3"], prior: MotionPrior | None, unit: Float64[Array, "5"]) -> _Motion:
    """Velocity and rates; the spin about the normal, which does not change the ring, is 0."""
    if prior is None:
        return _Motion(np.zeros(3), np.zeros(3))
    return _Motion(prior.speed_sd_m_s * unit[:3], prior.rate_sd_rad_s * unit[3:] @ tilt_basis(normal))


class _Course(NamedTuple):
    """Motion of the ring during a shot, relative to the pose at which its arcs are given."""

    scene: Scene
    view: RingView
    arcs: RingArcs
    axes: Float64[Array, "3 3"]
    drawn: _Motion
    """Constant velocities of a view without a path."""
    start_s: float
    """When the arcs hold: of a view with a path at the beginning of the shot (0), else at the time of its pose."""

    def at(self, time_s: float) -> tuple[RingArcs, Float64[Array, "3 3"]]:
        """The ring's arcs, and its x, y and z axes as columns, at a time since the beginning of the shot."""
        if self.view.path is None:
            since_s, (velocity_m_s, rate_rad_s) = time_s - self.start_s, self.drawn
            return self.arcs.after(since_s, velocity_m_s, rate_rad_s), rotation_by(rate_rad_s * since_s) @ self.axes
        placement = target_placement(self.scene, self.view, time_s)
        center_m = placement.points_camera(np.array([0.0, 0.0, self.scene.ring.height_m]))
        turn = cross(self.arcs.normal, placement.rotation[:, 2])
        length = float(np.linalg.norm(turn))
        turn *= np.arctan2(length, self.arcs.normal @ placement.rotation[:, 2]) / length if length > 0 else 0.0
        return self.arcs.after(1.0, center_m - self.arcs.center, turn), placement.rotation

    def motion(self, time_s: float) -> _Motion:
        """Velocity of the ring's centre, and rates, at a time."""
        if self.view.path is None:
            return self.drawn
        face_m = np.array([0.0, 0.0, self.scene.ring.height_m])
        return _Motion(*velocities(self.view.path, self.view.begin_s + time_s, face_m))


class _Outliers(NamedTuple):
    displaced: Bool[Array, "laser edge=2"]
    shift_px: Float64[Array, "laser edge=2"]
    behind_m: Float64[Array, "laser"]
    missing: Bool[Array, "laser"]


def _outliers(deviations: Deviations, picks: Float64[Array, "laser 7"]) -> _Outliers:
    """Outliers by uniform random numbers."""
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
    )


# Geometry: where the stripes are in the image


class _Stripes(NamedTuple):
    """True stripes in the (distorted) image; NaN where they are not."""

    true_px: Float64[Array, "laser edge=2 xy=2"]
    """Break points; NaN outside the image or not lit."""
    start_px: Float64[Array, "laser xy=2"]
    """Left end of the stripe on the face, clipped to the image."""
    end_px: Float64[Array, "laser xy=2"]
    edge_at_start: Int64[Array, "laser"]
    """Edge that the left end belongs to."""


BORDER_PX = 3.0
"""Distance from the image's left or right border within which an end is not measured, as in the detector."""

MIN_COLUMNS = 10
"""Minimum length of a stripe that is detected."""

_SAMPLES = 257
"""Points along a stripe by which it is clipped."""


def _stripes(
    ring: RingShape,
    appearance: Appearance,
    common: CommonErrors,
    course: _Course,
    time_s: Float64[Array, "laser"],
    behind_m: Float64[Array, "laser"],
) -> _Stripes:
    """The stripes of all lasers, each at the time of its frame."""
    camera, lasers = common.rig.camera, common.rig.lasers
    point_m = np.full((len(time_s), 2, 3), np.nan)
    own_m = point_m.copy()  # the same in the ring's axes
    for laser in np.flatnonzero(appearance.lit):
        moved, axes = course.at(float(time_s[laser]))
        if behind_m[laser]:
            moved = moved.moved(-float(behind_m[laser]) * np.eye(len(STEP))[LIFT])
        plane = lasers.normal[[laser]], lasers.distance_m[[laser]]
        point_m[laser] = predicted_break_points(moved, *plane)[0]
        if common.form.any():
            point_m[laser] += form_displacement(common.form, point_m[laser], moved, axes, plane[0][0])
        own_m[laser] = (point_m[laser] - moved.center) @ axes
        if behind_m[laser]:
            own_m[laser] = np.nan  # the surface behind the ring has no gaps
    position_px = project(point_m, camera)
    inside = inside_image(position_px, BORDER_PX, camera) & ~in_gap(ring, own_m)
    start_px, end_px, edge_at_start = _clipped(ring, point_m, own_m, position_px, inside, camera)
    return _Stripes(np.where(inside[..., None], position_px, np.nan), start_px, end_px, edge_at_start)


def _clipped(
    ring: RingShape,
    point_m: Float64[Array, "laser edge=2 xyz=3"],
    own_m: Float64[Array, "laser edge=2 xyz=3"],
    position_px: Float64[Array, "laser edge=2 xy=2"],
    inside: Bool[Array, "laser edge=2"],
    camera: Camera,
) -> tuple[Float64[Array, "laser xy=2"], Float64[Array, "laser xy=2"], Int64[Array, "laser"]]:
    """Left and right ends of the stripes on the face in the image, and the edge of the left one; NaN if not in view."""
    ends_px = position_px.copy()
    for laser in np.flatnonzero(~inside.all(axis=1) & np.isfinite(position_px).all(axis=(1, 2))):
        share = np.linspace(0.0, 1.0, _SAMPLES)[:, None]
        shown_px = project(point_m[laser, 0] + share * (point_m[laser, 1] - point_m[laser, 0]), camera)
        missing = in_gap(ring, own_m[laser, 0] + share * (own_m[laser, 1] - own_m[laser, 0]))
        visible = np.flatnonzero(inside_image(shown_px, BORDER_PX, camera) & ~missing)
        ends_px[laser] = shown_px[visible[[0, -1]]] if len(visible) else np.nan
    ends_px[~(np.abs(ends_px[:, 1, 0] - ends_px[:, 0, 0]) >= MIN_COLUMNS)] = np.nan
    left = (ends_px[:, 1, 0] < ends_px[:, 0, 0]).astype(np.int64)
    each = np.arange(len(left))
    return ends_px[each, left], ends_px[each, 1 - left], left


# Drawing


def _drawn_points(
    stripes: _Stripes,
    appearance: Appearance,
    unit: Float64[Array, "laser 4"],
    outliers: _Outliers,
    seen: Bool[Array, "laser"],
) -> BreakPoints:
    """Break points and lines with errors by standard normal numbers; the lines in distorted pixels."""
    lasers, left = np.arange(len(seen)), stripes.edge_at_start
    chord_px = stripes.end_px - stripes.start_px
    columns = chord_px[:, 0]
    used = columns - 2.0 * np.minimum(np.floor(columns / COLUMNS_PER_CUT), CUT_CENTRES)
    line_sigma_px = np.array(
        [
            np.nan if center is None else center.line_sigma_px(number)
            for center, number in zip(appearance.centers, used.tolist(), strict=True)
        ]
    )
    # errors of the ordinates at both ends of a line through the used centres: variance (1 + 3 / share^2) s^2
    tilt_sigma_px = sqrt(3.0) * columns / used * line_sigma_px
    end_variance_px2 = line_sigma_px**2 + tilt_sigma_px**2
    middle_px = line_sigma_px * unit[:, 0]
    tilt_px = tilt_sigma_px * unit[:, 1]
    start_px, end_px = stripes.start_px.copy(), stripes.end_px.copy()
    start_px[:, 1] += middle_px - tilt_px
    end_px[:, 1] += middle_px + tilt_px
    across_px = np.empty((len(seen), 2))
    across_px[lasers, left], across_px[lasers, 1 - left] = middle_px - tilt_px, middle_px + tilt_px

    along_px = appearance.end_sigma_px * unit[:, 2:] + outliers.shift_px
    direction = np.stack([np.ones(len(seen)), chord_px[:, 1] / chord_px[:, 0]], axis=1)
    position_px = stripes.true_px + along_px[..., None] * direction[:, None]
    position_px[..., 1] += across_px
    spread = (direction[:, :, None] * direction[:, None])[:, None]
    covariance_px2 = (appearance.end_sigma_px**2)[..., None, None] * spread
    covariance_px2[..., 1, 1] += end_variance_px2[:, None]
    measured = np.isfinite(stripes.true_px[..., 0]) & seen[:, None]
    saturated = np.array([center is not None and center.saturated for center in appearance.centers])
    flags = np.where(measured & saturated[:, None], int(BreakPointFlag.SATURATED), 0)
    flags += np.where(~measured & seen[:, None], int(BreakPointFlag.CLIPPED), 0)
    return BreakPoints(
        position_px=np.where(measured[..., None], position_px, np.nan),
        covariance_px2=np.where(measured[..., None, None], covariance_px2, np.nan),
        flags=flags.astype(np.int64),
        face_start_px=np.where(seen[:, None], start_px, np.nan),
        face_end_px=np.where(seen[:, None], end_px, np.nan),
        face_sigma_px=np.where(seen, np.sqrt(end_variance_px2), np.nan)[:, None] * np.ones(2),
        labelled=True,
    )


def _edges_of_frames(
    scene: Scene,
    appearance: Appearance,
    common: CommonErrors,
    course: _Course,
    middle_s: Float64[Array, "frame"],
    stamp_s: float,
    unit: Float64[Array, "place"],
    *,
    moving: bool,
) -> RingEdgePoints | None:
    """Points of the visible edges in the frames that the detector searches: of a moving ring two, else one.

    Most errors come from what lies beside the edges and are the same in both frames: the stated standard deviations are
    raised so that two frames of a ring at rest determine it no better than one.
    """
    numbers = [appearance.edges.frame]
    dark = [number for number, mask in enumerate(scene.sequence) if not mask]
    if dark and moving:
        numbers = sorted({dark[0], dark[-1]})
    parts = [
        _drawn_edges(scene.ring, appearance, common, course, float(middle_s[number]), stamp_s, unit)
        for number in numbers
    ]
    found = [replace(part, sigma_px=sqrt(len(parts)) * part.sigma_px) for part in parts if part is not None]
    return joined_edge_points(found) if found else None


def _drawn_edges(
    ring: RingShape,
    appearance: Appearance,
    common: CommonErrors,
    course: _Course,
    time_s: float,
    stamp_s: float,
    unit: Float64[Array, "place"],
) -> RingEdgePoints | None:
    """Points of the visible edges in a frame, with errors by standard normal numbers; None without any."""
    visible, camera = appearance.edges, common.rig.camera
    arcs, axes = course.at(time_s)
    place_m, outward = edge_points(arcs, visible.along_m, np.array(EDGE_SIGN)[visible.edge])
    own_m = (place_m - arcs.center) @ axes
    if common.form.any():
        radial_m, axial_m = form_deviations(common.form, own_m, visible.edge)
        place_m = place_m + radial_m[:, None] * outward + axial_m[:, None] * arcs.normal
    position_px = project(place_m, camera)
    shown = inside_image(position_px, EDGE_MARGIN_PX, camera) & ~in_gap(ring, own_m)
    if not shown.any():
        return None
    off_face = np.array(EDGE_SIGN)[visible.edge[shown], None] * outward[shown]
    normal, _ = edge_normals_px(place_m[shown], off_face, arcs, camera)
    return RingEdgePoints(
        position_px=position_px[shown] + (visible.sigma_px * unit)[shown, None] * normal,
        normal=normal,
        sigma_px=visible.sigma_px[shown],
        edge=visible.edge[shown],
        stamp_s=np.full(int(shown.sum()), stamp_s + time_s),
    )


def _as_measured(points: BreakPoints, camera: Camera, labelled: bool, stamp_s: Float64[Array, "laser"]) -> BreakPoints:
    """The break points with their lines undistorted by the camera that the detector knows."""
    ends_px = np.stack([points.face_start_px, points.face_end_px])
    straight_px, below_px = undistorted_pixels(np.stack([ends_px, ends_px + np.array([0.0, 1.0])]), camera)
    return replace(
        points,
        face_start_px=straight_px[0],
        face_end_px=straight_px[1],
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
    course: _Course,
    outliers: _Outliers,
    *,
    moving: bool,
) -> Truth:
    """The truth of a drawn shot; the groups name its outliers."""
    names = scene.rig.lasers.names
    usable = int(np.isfinite(position_px[..., 0]).sum())
    groups = {
        "rig": scene.rig.camera.camera_name,
        "light": view.light,
        "frames": len(scene.sequence),
        **view.groups,
        "usable": usable,
    }
    if usable == 0:
        return Truth(shot=view.name, expect="no_target", groups=groups)
    points = [f"{names[laser]}.{EDGES[edge]}" for laser, edge in np.argwhere(outliers.displaced).tolist()]
    wrong = {
        "displaced": ",".join(points),
        "background": ",".join(names[laser] for laser in np.flatnonzero(outliers.behind_m)),
        "missing": ",".join(names[laser] for laser in np.flatnonzero(outliers.missing)),
    }
    center_m, normal = view.center_m, view.normal
    if view.path is not None:
        arcs, _ = course.at(time_s)
        center_m, normal = arcs.center, arcs.normal
    motion = course.motion(time_s) if moving else None
    return Truth(
        shot=view.name,
        expect="pose" if usable == position_px[..., 0].size else "partial",
        center_m=center_m,
        normal=normal,
        radius_inner_m=scene.ring.radius_inner_m,
        radius_outer_m=scene.ring.radius_outer_m,
        break_points_px=position_px,
        stamp_s=stamp_s + time_s if motion else None,
        velocity_m_s=motion.velocity_m_s if motion else None,
        angular_velocity_rad_s=motion.rate_rad_s if motion else None,
        groups={"ring": f"R{1000 * scene.ring.radius_outer_m:.0f}", **groups, **{k: v for k, v in wrong.items() if v}},
    )
