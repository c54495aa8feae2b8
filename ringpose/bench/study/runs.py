"""Shots of a study in succession: a target in steady motion, and its track.

The target has a constant velocity and constant rates across its normal in the camera frame, as `ringpose pose` assumes
within a shot; its pose and its place are those of the study's factors at the beginning of the last shot.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ringpose.bench.score import PoseEstimate
from ringpose.geometry.ring import rotation_by
from ringpose.geometry.rotations import tilt_basis
from ringpose.simulate.motion import moved_view
from ringpose.simulate.placement import ring_rotation
from ringpose.track.explanations import TrackOptions
from ringpose.track.pipeline import Tracker
from ringpose.types.arrays import Array, Float64
from ringpose.types.assumptions import MotionPrior
from ringpose.types.pose import PoseLine
from ringpose.types.rig import Rig
from ringpose.types.scene import RingView, Scene
from ringpose.types.study import ShotRun


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SteadyPath:
    """A `TargetPath` at constant velocity of the ring's centre and constant angular velocity."""

    center_m: Float64[Array, "xyz=3"]
    """Of the ring's face at time 0, as is the rotation."""
    rotation: Float64[Array, "3 3"]
    face_m: Float64[Array, "xyz=3"]
    """That point in the target frame."""
    velocity_m_s: Float64[Array, "xyz=3"]
    angular_velocity_rad_s: Float64[Array, "xyz=3"]

    def camera_from_target(self, time_s: float) -> tuple[Float64[Array, "3 3"], Float64[Array, "xyz=3"]]:
        """See `TargetPath`."""
        rotation = rotation_by(self.angular_velocity_rad_s * time_s) @ self.rotation
        return rotation, self.center_m + self.velocity_m_s * time_s - rotation @ self.face_m

    def inertial_from_camera(self, time_s: float) -> Float64[Array, "3 3"]:
        """See `TargetPath`; the camera does not turn."""
        return np.eye(3)


def with_run(scene: Scene, run: ShotRun, prior: MotionPrior | None, rng: np.random.Generator) -> Scene:
    """The scene of one view as a run of shots, the last of which begins in the pose of the view.

    The motion is drawn from `prior`; without one the target is still.
    """
    (view,) = scene.views
    if run.shots == 1 and prior is None:
        return scene
    path = None if prior is None else _drawn_path(scene, view, prior, rng)
    names = [f"{view.name}_{number:04d}" for number in range(run.shots - 1)]
    begins_s = run.period_s * np.arange(1 - run.shots, 0)
    views = (
        replace(view, name=name) if path is None else moved_view(view, path, float(begin_s), path.face_m, name)
        for name, begin_s in zip(names, begins_s, strict=True)
    )
    last = view if path is None else replace(view, path=path)
    return replace(scene, views=(*views, last), shots=run.shots, period_s=run.period_s)


def _drawn_path(scene: Scene, view: RingView, prior: MotionPrior, rng: np.random.Generator) -> SteadyPath:
    unit = rng.standard_normal(5)
    return SteadyPath(
        center_m=view.center_m,
        rotation=ring_rotation(view.normal, view.roll_rad),
        face_m=np.array([0.0, 0.0, scene.ring.height_m]),
        velocity_m_s=prior.speed_sd_m_s * unit[:3],
        angular_velocity_rad_s=prior.rate_sd_rad_s * unit[3:] @ tilt_basis(view.normal),
    )


def tracked(lines: Sequence[PoseLine], rig: Rig, prior: MotionPrior | None) -> tuple[PoseEstimate, str | None]:
    """The state after the last of the pose lines, and why it has no pose.

    The track assumes the motion of `prior`; like `ringpose track` it does not take a target for still, and uses its
    defaults for a speed or rate of 0.
    """
    options = TrackOptions()
    if prior is not None:
        speed_sd_m_s = prior.speed_sd_m_s or options.motion.speed_sd_m_s
        rate_sd_rad_s = prior.rate_sd_rad_s or options.motion.rate_sd_rad_s
        options = replace(options, motion=MotionPrior(speed_sd_m_s=speed_sd_m_s, rate_sd_rad_s=rate_sd_rad_s))
    tracker = Tracker(rig, options)
    for line in lines[:-1]:
        tracker.add(line)
    last = tracker.line_of(tracker.add(lines[-1]))
    estimate = PoseEstimate(
        shot=lines[-1].shot,
        method="track",
        pose=last.pose,
        status=last.status,
        flags=last.flags,
        stamp_s=last.stamp_s if math.isfinite(last.stamp_s) else lines[-1].stamp_s,
        shot_stamp_s=lines[-1].stamp_s,
        velocity=last.velocity,
    )
    return estimate, None if last.pose is not None else f"the track is {last.validity}"
