"""Where the stripes of a moving ring lie in the image, each at the time of its laser's frame.

The true rig and the true form of the ring, which differ from those that an estimator assumes, are drawn once for all
shots of a run.
"""

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from ringpose.errors import DataError
from ringpose.estimate.nuisance import FORM_ORDERS, form_amplitude_m, rig_errors
from ringpose.geometry.rays import project
from ringpose.geometry.ring import LIFT, STEP, Rates, RingArcs, predicted_break_points, rotation_by
from ringpose.geometry.rotations import cross, tilt_basis, tilted
from ringpose.optics.feature_errors import BORDER_PX, MIN_COLUMNS
from ringpose.simulate.appearance import Appearance
from ringpose.simulate.break_points import form_displacement, in_gap, inside_image
from ringpose.simulate.motion import velocities
from ringpose.simulate.placement import target_placement
from ringpose.types.arrays import Array, Bool, Float64, Int64
from ringpose.types.assumptions import MotionPrior
from ringpose.types.rig import Camera, Rig
from ringpose.types.scene import RingView, Scene
from ringpose.types.target import RingForm, RingShape


class RunErrors(NamedTuple):
    """The true rig and the true ring's form, whose errors all shots of a run have in common."""

    rig: Rig
    """The true rig."""
    form: RingForm
    """Deviations of the true ring from circles in a plane."""


def drawn_run_errors(
    rig: Rig, rng: np.random.Generator, *, ring_tolerance_m: float = 0.0, with_rig_errors: bool = False
) -> RunErrors:
    """Draw the true rig and the form of the true ring of a run; `rig` is the calibrated rig.

    The form's deviations have the standard deviation `ring_tolerance_m` at any angle (ringpose-method(7), section 12).
    """
    # the form is drawn first, and also for a tolerance of 0: the rig does not depend on the tolerance
    scale_m = form_amplitude_m(ring_tolerance_m)
    form = RingForm(
        radial_m=scale_m * rng.standard_normal((2, len(FORM_ORDERS), 2)),
        axial_m=scale_m * rng.standard_normal((len(FORM_ORDERS), 2)),
    )
    return RunErrors(drawn_rig(rig, rng) if with_rig_errors else rig, form)


def drawn_rig(rig: Rig, rng: np.random.Generator) -> Rig:
    """A random rig, drawn from the covariance and the stability of `rig`; it has no covariance itself."""
    errors = rig_errors(rig, rig.stability)
    if errors is None:
        raise DataError(
            "the scene's rig", "has neither covariance nor stability", "calibrate it, or do not draw rig errors"
        )
    drawn = errors.root @ rng.standard_normal(errors.root.shape[1])
    camera, planes = errors.camera @ drawn, errors.lasers @ drawn
    focal_x, focal_y, center_x, center_y = camera[:4].tolist()
    matrix = rig.camera.camera_matrix + np.array([[focal_x, 0, center_x], [0, focal_y, center_y], [0, 0, 0]])
    normals = [tilted(normal, plane[:2]) for normal, plane in zip(rig.lasers.normal, planes, strict=True)]
    return replace(
        rig,
        camera=replace(
            rig.camera,
            camera_matrix=matrix,
            distortion_coefficients=rig.camera.distortion_coefficients + camera[4:],
            covariance=None,
        ),
        lasers=replace(rig.lasers, normal=np.array(normals), distance_m=rig.lasers.distance_m + planes[:, 2]),
        covariance=None,
    )


def drawn_motion(normal: Float64[Array, "3"], prior: MotionPrior | None, unit: Float64[Array, "5"]) -> Rates:
    """Constant velocity and rates of a ring from the prior and five standard normal numbers; the spin is 0."""
    if prior is None:
        return Rates(np.zeros(3), np.zeros(3))
    return Rates(prior.speed_sd_m_s * unit[:3], prior.rate_sd_rad_s * unit[3:] @ tilt_basis(normal))


class ShotMotion(NamedTuple):
    """Motion of the ring during a shot: along the path of its view, or else at constant velocities."""

    scene: Scene
    view: RingView
    arcs: RingArcs
    axes: Float64[Array, "3 3"]
    drawn: Rates
    """Constant velocities of a view without a path."""
    start_s: float
    """Time since the beginning of the shot at which `arcs` and `axes` hold."""

    def at(self, time_s: float) -> tuple[RingArcs, Float64[Array, "3 3"]]:
        """The ring's arcs, and its x, y and z axes as columns, at a time since the beginning of the shot."""
        if self.view.path is None:
            since_s, (velocity_m_s, rate_rad_s) = time_s - self.start_s, self.drawn
            return self.arcs.predict(since_s, velocity_m_s, rate_rad_s), rotation_by(rate_rad_s * since_s) @ self.axes
        placement = target_placement(self.scene, self.view, time_s)
        center_m = placement.points_camera(np.array([0.0, 0.0, self.scene.ring.height_m]))
        turn = cross(self.arcs.normal, placement.rotation[:, 2])
        length = float(np.linalg.norm(turn))
        turn *= np.arctan2(length, self.arcs.normal @ placement.rotation[:, 2]) / length if length > 0 else 0.0
        return self.arcs.predict(1.0, center_m - self.arcs.center, turn), placement.rotation

    def motion(self, time_s: float) -> Rates:
        """Velocity of the ring's centre, and angular velocity, at a time since the beginning of the shot."""
        if self.view.path is None:
            return self.drawn
        face_m = np.array([0.0, 0.0, self.scene.ring.height_m])
        return Rates(*velocities(self.view.path, self.view.begin_s + time_s, face_m))


class StripeEnds(NamedTuple):
    """True positions of the stripes on the ring's face in distorted pixels; NaN for what is not visible."""

    true_px: Float64[Array, "laser edge=2 xy=2"]
    """Break points; NaN outside the image or not lit."""
    start_px: Float64[Array, "laser xy=2"]
    """Left end of the stripe on the face, clipped to the image."""
    end_px: Float64[Array, "laser xy=2"]
    edge_at_start: Int64[Array, "laser"]
    """Edge that the left end belongs to."""


_SAMPLES = 257
"""Points along a stripe by which it is clipped."""


def stripe_ends(
    ring: RingShape,
    appearance: Appearance,
    common: RunErrors,
    shot_motion: ShotMotion,
    time_s: Float64[Array, "laser"],
    behind_m: Float64[Array, "laser"],
) -> StripeEnds:
    """The stripes of all lasers, each at the time of its frame.

    `behind_m` is the distance of the surface that a stripe lies on behind the face; 0 for the face itself.
    """
    camera, lasers = common.rig.camera, common.rig.lasers
    point_m = np.full((len(time_s), 2, 3), np.nan)
    own_m = point_m.copy()  # the same in the ring's axes
    for laser in np.flatnonzero(appearance.lit):
        moved, axes = shot_motion.at(float(time_s[laser]))
        if behind_m[laser]:
            moved = moved.retract(-float(behind_m[laser]) * np.eye(len(STEP))[LIFT])
        normal = lasers.normal[[laser]]
        one = predicted_break_points(moved, normal, lasers.distance_m[[laser]])
        if common.form.any():
            one += form_displacement(common.form, one, moved.center, axes, normal)
        point_m[laser] = one[0]
        own_m[laser] = (point_m[laser] - moved.center) @ axes
        if behind_m[laser]:
            own_m[laser] = np.nan  # the surface behind the ring has no gaps
    position_px = project(point_m, camera)
    inside = inside_image(position_px, BORDER_PX, camera) & ~in_gap(ring, own_m)
    start_px, end_px, edge_at_start = _clipped(ring, point_m, own_m, position_px, inside, camera)
    return StripeEnds(np.where(inside[..., None], position_px, np.nan), start_px, end_px, edge_at_start)


def _clipped(
    ring: RingShape,
    point_m: Float64[Array, "laser edge=2 xyz=3"],
    own_m: Float64[Array, "laser edge=2 xyz=3"],
    position_px: Float64[Array, "laser edge=2 xy=2"],
    inside: Bool[Array, "laser edge=2"],
    camera: Camera,
) -> tuple[Float64[Array, "laser xy=2"], Float64[Array, "laser xy=2"], Int64[Array, "laser"]]:
    """Left and right ends of the stripes on the face, clipped to the image, and the edge at the left end.

    NaN for a stripe that is not in view.
    """
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
