"""Poses of ring and boards in the camera frame: those of the scene file, or random ones within its limits."""

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from threading import RLock
from typing import Any, overload

import numpy as np

from ringpose.errors import DataError
from ringpose.geometry.board import outline_m
from ringpose.geometry.rays import rays
from ringpose.geometry.ring import rotation_by
from ringpose.geometry.rotations import facing_normal
from ringpose.simulate.motion import moved_view, target_paths
from ringpose.types.arrays import Array, Float64
from ringpose.types.board import Board
from ringpose.types.rig import Camera
from ringpose.types.scene import Approach, BoardApproach, BoardSet, NamedBoardPose, RingView, Scene
from ringpose.types.target import TargetPath

READOUT_S = 0.002
"""Time between the end of an exposure and the start of the next."""

MIN_DURATION_S, MAX_DURATION_S = 2e-5, 0.1
"""Exposure times of common cameras, the range of an automatic exposure."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Placement:
    """Pose of the target in the camera frame: `point_camera = rotation @ point_target + translation_m`."""

    rotation: Float64[Array, "3 3"]
    translation_m: Float64[Array, "xyz=3"]

    @property
    def eye_m(self) -> Float64[Array, "xyz=3"]:
        """The projection centre in the target frame."""
        return self.points_target(np.zeros((3, 1)))[:, 0]

    def points_target(self, point_camera: Float64[Array, "xyz=3 n"]) -> Float64[Array, "xyz=3 n"]:
        """Transform points from the camera frame to the target frame."""
        return self.vectors_target(point_camera - self.translation_m[:, None])

    def points_camera(self, point_target: Float64[Array, "*shape xyz=3"]) -> Float64[Array, "*shape xyz=3"]:
        """Transform points, in rows, from the target frame to the camera frame."""
        return point_target @ self.rotation.T + self.translation_m

    def vectors_target(self, vector_camera: Float64[Array, "xyz=3 n"]) -> Float64[Array, "xyz=3 n"]:
        """Transform directions from the camera frame to the target frame."""
        return self.rotation.T @ vector_camera


def ring_rotation(normal: Float64[Array, "3"], roll_rad: float) -> Float64[Array, "3 3"]:
    """Axes of the target frame as columns: z along the normal, x nearest to the camera's x for zero roll."""
    z = normal / np.linalg.norm(normal)
    x = np.array([1.0, 0.0, 0.0]) - z[0] * z
    x /= np.linalg.norm(x)
    y = np.cross(z, x)
    cosine, sine = np.cos(roll_rad), np.sin(roll_rad)
    return np.stack([cosine * x + sine * y, cosine * y - sine * x, z], axis=1)


def target_placement(scene: Scene, view: RingView, time_s: float = 0.0) -> Placement:
    """Placement of the target at a time since the beginning of the shot of a view."""
    if view.path is not None:
        rotation, translation_m = view.path.camera_from_target(view.begin_s + time_s)
        return Placement(rotation=rotation, translation_m=translation_m)
    rotation = ring_rotation(view.normal, view.roll_rad)
    return Placement(rotation=rotation, translation_m=view.center_m - scene.ring.height_m * rotation[:, 2])


def ring_views(scene: Scene) -> "RingViews":
    """All views of a scene: the given ones, then the random ones; of a moving target, each as a run of shots."""
    return RingViews(scene)


class RingViews(Sequence[RingView]):
    """The views of a scene, each drawn and moved when it is asked for: the first shot does not wait for the last."""

    def __init__(self, scene: Scene) -> None:
        self._scene, self._shots = scene, 1 if scene.motion is None else scene.shots
        self._views = list(scene.views)
        self._random = (view for approach in scene.approaches for view in _random_views(scene, approach))
        self.runs = len(scene.views) + sum(
            approach.count * len(approach.distances_m) * len(approach.lights) for approach in scene.approaches
        )
        """Number of views that are given or drawn; a moving target makes a run of shots of each."""
        self._lock = RLock()
        self._reject_equal_names()

    def __reduce__(self) -> tuple[Any, ...]:
        return RingViews, (self._scene,)

    def __len__(self) -> int:
        return self.runs * self._shots

    @overload
    def __getitem__(self, index: int) -> RingView: ...
    @overload
    def __getitem__(self, index: slice) -> tuple[RingView, ...]: ...
    def __getitem__(self, index: int | slice) -> RingView | tuple[RingView, ...]:
        if isinstance(index, slice):
            return tuple(self[number] for number in range(*index.indices(len(self))))
        run, shot = divmod(range(len(self))[index], self._shots)
        start, scene = self._start(run), self._scene
        if scene.motion is None:
            return start
        path, face_m = self._paths[run], np.array([0.0, 0.0, scene.ring.height_m])
        name = f"{start.name}_{shot:04d}" if self._shots > 1 else start.name
        return moved_view(start, path, shot * scene.period_s, face_m, name)

    @property
    def begins(self) -> tuple[RingView, ...]:
        """The first shot of each run."""
        return self[:: self._shots]

    def _start(self, run: int) -> RingView:
        """The view that is given or drawn; the drawn ones follow each other from one generator."""
        with self._lock:
            while len(self._views) <= run:
                self._views.append(next(self._random))
        return self._views[run]

    @cached_property
    def _paths(self) -> list[TargetPath]:
        """The path of each run."""
        scene = self._scene
        assert scene.motion is not None
        placed = [target_placement(scene, self._start(run)) for run in range(self.runs)]
        shot_s = len(scene.sequence) * (max(scene.exposure_s, MAX_DURATION_S) + READOUT_S)
        starts = [(each.rotation, each.translation_m) for each in placed]
        return target_paths(starts, scene.motion, (self._shots - 1) * scene.period_s + shot_s)

    def _reject_equal_names(self) -> None:
        """Reject two views of one name. Drawn views of two sets have equal names if the first ones have."""
        given = {view.name for view in self._scene.views}
        drawn = [replace(approach, count=min(approach.count, 1)) for approach in self._scene.approaches]
        names = Counter(
            [view.name for view in self._scene.views] + [name for approach in drawn for name in _names(approach)]
        )
        doubled = [name for name, count in names.items() if count > 1]
        doubled += [name for approach in self._scene.approaches if given for name in _names(approach) if name in given]
        if doubled:
            finding = f"two views are called {doubled[0]!r}"
            raise DataError("the scene's trajectory", finding, "give each generated set its own name")


def _names(approach: Approach) -> Iterator[str]:
    """Names of random views, in the order of `_random_views`."""
    for distance_m in approach.distances_m:
        for number in range(approach.count):
            for light in approach.lights:
                yield f"{approach.name}{1000 * distance_m:04.0f}_p{number:02d}_{light}"


def _random_views(scene: Scene, approach: Approach) -> Iterator[RingView]:
    """Random views for each distance, pose and light, in this order."""
    generator, names = np.random.default_rng([scene.seed, approach.seed]), _names(approach)
    for distance_m in approach.distances_m:
        for _ in range(approach.count):
            normal, center_m = _random_ring_pose(scene, approach, distance_m, generator)
            for light in approach.lights:
                yield RingView(
                    name=next(names),
                    center_m=center_m,
                    normal=normal,
                    light=light,
                    target=approach.target,
                    groups={"distance_m": distance_m},
                )


def _random_ring_pose(
    scene: Scene, approach: Approach, distance_m: float, generator: np.random.Generator
) -> tuple[Float64[Array, "3"], Float64[Array, "3"]]:
    """Normal and centre such that a point of the mean circle of the rim lies near the optical axis at this depth.

    With `whole` that point is the centre.
    """
    pitch_rad, yaw_rad = generator.uniform(-1, 1, 2) * approach.tilt_rad
    normal = facing_normal(pitch_rad, yaw_rad)
    side, clock_rad = generator.choice([-1.0, 1.0]), generator.uniform(-1, 1) * approach.clock_rad
    point_m = distance_m * image_ray(scene.rig.camera, approach.offset * generator.uniform(-1, 1, 2))
    axes = ring_rotation(normal, 0.0)
    outward = side * (np.cos(clock_rad) * axes[:, 0] + np.sin(clock_rad) * axes[:, 1])
    radius_m = 0.0 if approach.whole else (scene.ring.radius_inner_m + scene.ring.radius_outer_m) / 2
    return normal, point_m - radius_m * outward


def image_ray(camera: Camera, offset: Float64[Array, "xy=2"]) -> Float64[Array, "xyz=3"]:
    """The ray through the image centre, shifted by fractions of the image width and height."""
    size = np.array([camera.image_width, camera.image_height], dtype=np.float64)
    return rays((size - 1) / 2 + offset * size, camera)


def board_poses(scene: Scene, boards: BoardSet) -> tuple[NamedBoardPose, ...]:
    """All poses of a board: the given ones, then the random ones."""
    if boards.approach is None:
        return boards.poses
    generator = np.random.default_rng([scene.seed, boards.approach.seed, boards.approach.count])
    approach = boards.approach
    return (*boards.poses, *(_random_board_pose(scene, boards, approach, k, generator) for k in range(approach.count)))


def _random_board_pose(
    scene: Scene, boards: BoardSet, approach: BoardApproach, number: int, generator: np.random.Generator
) -> NamedBoardPose:
    """A random pose with the board's centre at a depth within the limits; with lasers on, near their stripes."""
    nearest_m, farthest_m = approach.distances_m
    depth_m = float(generator.uniform(nearest_m, farthest_m))
    middle = depth_m * image_ray(scene.rig.camera, approach.offset * generator.uniform(-1, 1, 2))
    if any(boards.sequence):
        planes, across = scene.rig.lasers, scene.rig.lasers.normal[:, :2]
        rest_m = planes.distance_m - planes.normal[:, 2] * depth_m
        nearest_m = across * (rest_m / (across**2).sum(axis=1))[:, None]  # point of each stripe nearest to the axis
        middle[:2] += nearest_m.mean(axis=0)
    lean_x, lean_y = generator.uniform(-1, 1, 2) * approach.tilt_rad
    turn = generator.uniform(-1, 1) * approach.turn_rad
    rotation = rotation_by(np.array([0.0, 0.0, turn])) @ rotation_by(np.array([0.0, lean_y, 0.0]))
    rotation = rotation @ rotation_by(np.array([lean_x, 0.0, 0.0]))
    return NamedBoardPose(
        name=f"board_{number:02d}", rotation=rotation, translation_m=middle - rotation @ middle_of_board_m(boards.board)
    )


def middle_of_board_m(board: Board) -> Float64[Array, "xyz=3"]:
    """The centre of the board in the board frame."""
    width_m, height_m = outline_m(board)
    return np.array([width_m / 2, height_m / 2, 0.0])
