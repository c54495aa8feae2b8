"""What the controls of the console set, and the scene that follows from it."""

from dataclasses import dataclass, field, replace

import numpy as np

from ringpose.geometry.ring import rotation_by
from ringpose.geometry.rotations import facing_normal
from ringpose.types.arrays import Array, Float64
from ringpose.types.scene import Light, RingView, Scene

LIGHT = "console"
"""Name of the light that the controls set."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Trajectory:
    """Poses of the ring at increasing times; in between, centre and normal are interpolated linearly."""

    time_s: Float64[Array, "pose"]
    """From 0."""
    center_m: Float64[Array, "pose xyz=3"]
    normal: Float64[Array, "pose xyz=3"]

    def at(self, time_s: float) -> tuple[Float64[Array, "xyz=3"], Float64[Array, "xyz=3"]]:
        """Centre and unit normal at a time; after the end, those of the last pose."""
        center_m, normal = (
            np.array([np.interp(time_s, self.time_s, part) for part in each.T]) for each in (self.center_m, self.normal)
        )
        return center_m, normal / np.linalg.norm(normal)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ConsoleState:
    """Positions of the controls; `number` grows with every change, so that each picture names its state."""

    center_m: Float64[Array, "xyz=3"]
    """Centre of the ring at time 0."""
    pitch_rad: float
    yaw_rad: float
    """Of its normal at time 0 (ringpose-method(7), section 4)."""
    roll_rad: float = 0.0
    spin_rad_s: float = 0.0
    """About the normal, which is not observable."""
    tumble_rad_s: float = 0.0
    """About the camera's x axis through the centre."""
    drift_m_s: Float64[Array, "xyz=3"] = field(default_factory=lambda: np.zeros(3))
    time_s: float = 0.0
    trajectory: Trajectory | None = None
    """Takes the place of pose, tumble and drift."""
    focal_scale: float = 1.0
    exposure_s: float | None = None
    """None for the rule of the scene."""
    laser_tilt_rad: tuple[float, ...] = ()
    """Rotation of each light plane about the camera's x axis through its projector; empty for none."""
    mask: int = 255
    """Lasers that are switched on at all."""
    is_switched: bool = True
    """Whether the lasers are switched one by one, after a dark frame; else all are on in one frame."""
    light: Light
    """Sun and ambient light."""
    number: int = 0

    @property
    def view(self) -> RingView:
        """Target and light at the state's time."""
        if self.trajectory is not None:
            center_m, normal = self.trajectory.at(self.time_s)
        else:
            turned = rotation_by(np.array([self.tumble_rad_s * self.time_s, 0.0, 0.0]))
            center_m = self.center_m + self.time_s * self.drift_m_s
            normal = turned @ facing_normal(self.pitch_rad, self.yaw_rad)
        return RingView(
            name=f"console_{self.number:06d}",
            center_m=center_m,
            normal=normal,
            roll_rad=self.roll_rad + self.spin_rad_s * self.time_s,
            light=LIGHT,
        )

    def sequence(self, lasers: int) -> tuple[int, ...]:
        """Masks of the frames of a shot."""
        on = self.mask & ((1 << lasers) - 1)
        if not self.is_switched:
            return (on,)
        return (0, *(1 << laser for laser in range(lasers) if on >> laser & 1))

    def scene_of(self, scene: Scene) -> Scene:
        """The scene with camera, lasers and light of this state."""
        lights = {LIGHT: self.light}
        camera, lasers = scene.rig.camera, scene.rig.lasers
        matrix = camera.camera_matrix.copy()
        matrix[[0, 1], [0, 1]] *= self.focal_scale
        if self.laser_tilt_rad:
            turned = [rotation_by(np.array([tilt, 0.0, 0.0])) for tilt in self.laser_tilt_rad]
            normal = np.stack([rotation @ each for rotation, each in zip(turned, lasers.normal, strict=True)])
            lasers = replace(lasers, normal=normal, distance_m=(normal * lasers.projector_m).sum(axis=1))
        rig = replace(scene.rig, camera=replace(camera, camera_matrix=matrix), lasers=lasers)
        changed = replace(scene, rig=rig, lights=lights, sequence=self.sequence(len(lasers.names)))
        return changed if self.exposure_s is None else replace(changed, exposure_s=self.exposure_s, stripe_dn=None)


def first_state(scene: Scene, view: RingView) -> ConsoleState:
    """The state that shows a view of the scene."""
    light = scene.lights[view.light]
    x, y, z = (-view.normal).tolist()
    return ConsoleState(
        center_m=view.center_m,
        pitch_rad=float(np.arcsin(np.clip(y, -1.0, 1.0))),
        yaw_rad=float(np.arctan2(x, z)),
        roll_rad=view.roll_rad,
        laser_tilt_rad=(0.0,) * len(scene.rig.lasers.names),
        light=replace(light, name=LIGHT),
    )
