"""What the controls of the console set, and the scene that follows from it."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from ringpose.geometry.ring import rotation_by
from ringpose.geometry.rotations import facing_angles, facing_normal
from ringpose.simulate.placement import ring_rotation
from ringpose.simulate.serve.preview import preview
from ringpose.types.arrays import Array, Float64
from ringpose.types.rig import Rig
from ringpose.types.scene import Light, RingView, Scene

LIGHT = "console"
"""Name of the light that the controls set."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Trajectory:
    """Poses of the ring at increasing times; in between, centre and normal are interpolated linearly."""

    time_s: Float64[Array, "pose"]
    """Ascending times from 0."""
    center_m: Float64[Array, "pose xyz=3"]
    normal: Float64[Array, "pose xyz=3"]

    def at(self, time_s: float) -> tuple[Float64[Array, "xyz=3"], Float64[Array, "xyz=3"]]:
        """Centre and unit normal at a time; after the end, centre and normal of the last pose."""
        center_m, normal = (
            np.array([np.interp(time_s, self.time_s, part) for part in rows.T]) for rows in (self.center_m, self.normal)
        )
        return center_m, normal / np.linalg.norm(normal)


def trajectory_of_views(views: Sequence[RingView], period_s: float) -> Trajectory:
    """The motion from each view of a scene to the next, of which each takes a period; moving ones where they begin."""
    return Trajectory(
        time_s=period_s * np.arange(len(views)),
        center_m=np.stack([view.center_m for view in views]),
        normal=np.stack([view.normal for view in views]),
    )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RigChange:
    """Differences of camera and lasers from the rig file, as the controls set them."""

    rig: Rig | None = None
    """A rig to take the place of the scene's."""
    focal_scale: float = 1.0
    pitch_scale: float = 1.0
    """Factor on the size of pixels; the focal length in millimetres stays."""
    laser_tilt_rad: tuple[float, ...] = ()
    """Rotation of each light plane about the camera's x axis through its projector; empty for none."""
    laser_shift_m: tuple[float, ...] = ()
    """Displacement of each projector, with its plane, along the camera's y axis; empty for none."""

    @property
    def is_none(self) -> bool:
        """Whether there is no difference: the rig is that of the scene."""
        return (
            self.rig is None
            and self.focal_scale == self.pitch_scale == 1.0
            and not any(self.laser_tilt_rad)
            and not any(self.laser_shift_m)
        )

    def applied_to(self, scene: Scene) -> Scene:
        """The scene with this rig and pixel pitch."""
        rig = scene.rig if self.rig is None else self.rig
        lasers, matrix = rig.lasers, rig.camera.camera_matrix.copy()
        matrix[[0, 1], [0, 1]] *= self.focal_scale / self.pitch_scale
        if any(self.laser_tilt_rad) or any(self.laser_shift_m):
            turned = [rotation_by(np.array([tilt, 0.0, 0.0])) for tilt in self.laser_tilt_rad]
            normal = np.stack([rotation @ normal for rotation, normal in zip(turned, lasers.normal, strict=True)])
            projector_m = np.where(np.isfinite(lasers.projector_m), lasers.projector_m, 0.0)
            moved_m = projector_m + np.outer(self.laser_shift_m, [0.0, 1.0, 0.0])
            # the tilted plane through the projector keeps its offset from it, which a rig file may give
            offset_m = lasers.distance_m - (lasers.normal * projector_m).sum(axis=1)
            distance_m = (normal * moved_m).sum(axis=1) + offset_m
            lasers = replace(lasers, normal=normal, projector_m=moved_m, distance_m=distance_m)
        return replace(
            scene,
            rig=replace(rig, camera=replace(rig.camera, camera_matrix=matrix), lasers=lasers),
            sensor=replace(scene.sensor, pixel_m=scene.sensor.pixel_m * self.pitch_scale),
        )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ConsoleState:
    """Positions of the controls; `number` grows with every change, so that each picture names its state."""

    center_m: Float64[Array, "xyz=3"]
    """Centre of the ring at time 0."""
    pitch_rad: float
    yaw_rad: float
    """Yaw of the normal at time 0 (ringpose-method(7), section 4)."""
    roll_rad: float = 0.0
    spin_rad_s: float = 0.0
    """Rate about the normal, which is not observable."""
    tumble_rad_s: float = 0.0
    """Rate about an axis through the centre, parallel to the camera's x axis."""
    drift_m_s: Float64[Array, "xyz=3"] = field(default_factory=lambda: np.zeros(3))
    time_s: float = 0.0
    trajectory: Trajectory | None = None
    """Takes the place of pose, tumble and drift."""
    rig_change: RigChange = RigChange()
    width: int | None = None
    """Width of the images; None for that of the camera."""
    exposure_s: float | None = None
    """None for the rule of the scene."""
    mask: int = 255
    """Lasers that are switched on at all."""
    masks: tuple[int, ...] = (0, 1, 2, 4)
    """Lasers that are on in each frame of a shot, as far as they are switched on."""
    light: Light
    """Sun, Earth and ambient light."""
    number: int = 0
    since: int = 0
    """Number of the state in which something other than the time was changed last; a track begins there."""

    @property
    def is_moving(self) -> bool:
        """Whether the target moves within a shot."""
        rates = (self.spin_rad_s, self.tumble_rad_s, *self.drift_m_s.tolist())
        return self.trajectory is not None or any(rates)

    def shows_target_of(self, other: "ConsoleState") -> bool:
        """Whether a measurement holds for both: at most the time differs, and the target does not move."""
        return self.since == other.since and (self.time_s == other.time_s or not self.is_moving)

    def pose_at(self, time_s: float) -> tuple[Float64[Array, "xyz=3"], Float64[Array, "xyz=3"]]:
        """Centre and normal of the ring at a time."""
        if self.trajectory is not None:
            return self.trajectory.at(time_s)
        turned = rotation_by(np.array([self.tumble_rad_s * time_s, 0.0, 0.0]))
        normal: Float64[Array, "xyz=3"] = turned @ facing_normal(self.pitch_rad, self.yaw_rad)
        return self.center_m + time_s * self.drift_m_s, normal

    def view(self, scene: Scene) -> RingView:
        """Target and light at the state's time, with the motion from then on."""
        center_m, normal = self.pose_at(self.time_s)
        return RingView(
            name=f"console_{self.number:06d}",
            center_m=center_m,
            normal=normal,
            roll_rad=self.roll_rad + self.spin_rad_s * self.time_s,
            light=LIGHT,
            path=StatePath(self, scene.ring.height_m) if self.is_moving else None,
            begin_s=self.time_s,
        )

    def scene_of(self, scene: Scene) -> Scene:
        """The scene with camera, lasers and light of this state, in images of the width of the state."""
        changed = self.rig_change.applied_to(scene)
        lasers = (1 << len(changed.rig.lasers.names)) - 1
        on = tuple(mask & self.mask & lasers for mask in self.masks)
        sequence = tuple(mask for mask, asked in zip(on, self.masks, strict=True) if mask or not asked) or (0,)
        changed = replace(
            changed,
            lights={LIGHT: self.light},
            sequence=sequence,
            seed=self.number,
            start_s=scene.start_s + self.time_s,
            motion=None,
            shots=1,
        )
        if self.exposure_s is not None:
            changed = replace(changed, exposure_s=self.exposure_s, stripe_dn=None)
        return changed if self.width is None else preview(changed, self.width)


@dataclass(frozen=True, slots=True, eq=False)
class StatePath:
    """The motion that the controls set."""

    state: ConsoleState
    face_height_m: float
    """Height of the ring's face in the target frame."""

    def camera_from_target(self, time_s: float) -> tuple[Float64[Array, "3 3"], Float64[Array, "xyz=3"]]:
        """See `TargetPath`; `time_s` is the time of the console."""
        center_m, normal = self.state.pose_at(time_s)
        rotation = ring_rotation(normal, self.state.roll_rad + self.state.spin_rad_s * time_s)
        return rotation, center_m - self.face_height_m * rotation[:, 2]

    def inertial_from_camera(self, time_s: float) -> Float64[Array, "3 3"]:
        """The camera does not turn."""
        return np.eye(3)


def first_state(scene: Scene, view: RingView) -> ConsoleState:
    """The state that shows a view of the scene."""
    light, lasers = scene.lights[view.light], len(scene.rig.lasers.names)
    pitch_rad, yaw_rad = facing_angles(view.normal)
    return ConsoleState(
        center_m=view.center_m,
        pitch_rad=pitch_rad,
        yaw_rad=yaw_rad,
        roll_rad=view.roll_rad,
        rig_change=RigChange(laser_tilt_rad=(0.0,) * lasers, laser_shift_m=(0.0,) * lasers),
        masks=tuple(mask & ((1 << lasers) - 1) for mask in scene.sequence),
        light=replace(light, name=LIGHT),
    )
