"""Where the boards stand: as the scene says, or drawn at random within its limits."""

import numpy as np

from ringpose.calibrate.boards.layout import outline_m
from ringpose.simulate.trajectory import picture_ray
from ringpose.types.arrays import Array, Float64
from ringpose.types.board import Board
from ringpose.types.rig import LaserPlanes
from ringpose.types.scene import BoardApproach, BoardPlace, BoardSet, Scene


def board_places(scene: Scene, boards: BoardSet) -> tuple[BoardPlace, ...]:
    """All places of a board: the written ones, then the drawn ones."""
    if boards.approach is None:
        return boards.places
    generator = np.random.default_rng([scene.seed, boards.approach.seed, boards.approach.count])
    drawn = [_drawn_place(scene, boards, boards.approach, k, generator) for k in range(boards.approach.count)]
    return (*boards.places, *drawn)


def _drawn_place(
    scene: Scene, boards: BoardSet, approach: BoardApproach, number: int, generator: np.random.Generator
) -> BoardPlace:
    """The board's middle at a depth between the limits, leaning and turned; with lasers on, where stripes are."""
    depth_m = float(generator.uniform(*approach.distances_m))
    middle = depth_m * picture_ray(scene.rig.camera, approach.offset * generator.uniform(-1, 1, 2))
    if any(boards.sequence):
        middle[:2] += _middle_of_stripes_m(scene.rig.lasers, depth_m)
    lean_x, lean_y = generator.uniform(-1, 1, 2) * approach.tilt_rad
    rotation = _about(2, generator.uniform(-1, 1) * approach.turn_rad) @ _about(1, lean_y) @ _about(0, lean_x)
    return BoardPlace(
        name=f"board_{number:02d}", rotation=rotation, translation_m=middle - rotation @ middle_of_board_m(boards.board)
    )


def middle_of_board_m(board: Board) -> Float64[Array, "xyz=3"]:
    """The middle of the board in its own frame."""
    width_m, height_m = outline_m(board)
    return np.array([width_m / 2, height_m / 2, 0.0])


def _middle_of_stripes_m(planes: LaserPlanes, depth_m: float) -> Float64[Array, "xy=2"]:
    """Mean, over the lasers, of the stripe's point nearest to the optical axis at a depth."""
    across = planes.normal[:, :2]
    rest_m = planes.distance_m - planes.normal[:, 2] * depth_m
    nearest: Float64[Array, "laser xy=2"] = across * (rest_m / (across**2).sum(axis=1))[:, None]
    middle: Float64[Array, "xy=2"] = nearest.mean(axis=0)
    return middle


def _about(axis: int, angle_rad: float) -> Float64[Array, "3 3"]:
    """Rotation about one of the axes."""
    first, second = (axis + 1) % 3, (axis + 2) % 3
    rotation = np.eye(3)
    rotation[first, first] = rotation[second, second] = np.cos(angle_rad)
    rotation[second, first] = np.sin(angle_rad)
    rotation[first, second] = -np.sin(angle_rad)
    return rotation
