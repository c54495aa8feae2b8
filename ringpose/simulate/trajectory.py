"""Where the ring stands, view by view: as the scene says, or drawn at random within its limits."""

from collections import Counter
from collections.abc import Iterator

import numpy as np

from ringpose.errors import DataError
from ringpose.geometry.rays import rays
from ringpose.geometry.rotations import facing_normal
from ringpose.simulate.placement import ring_rotation
from ringpose.types.arrays import Array, Float64
from ringpose.types.camera import Camera
from ringpose.types.scene import Approach, RingView, Scene


def ring_views(scene: Scene) -> tuple[RingView, ...]:
    """All views of a scene: the written ones, then the drawn ones."""
    drawn = [view for approach in scene.approaches for view in _drawn_views(scene, approach)]
    views = (*scene.views, *drawn)
    names = Counter(view.name for view in views)
    if len(names) < len(views):
        found = f"two views are called {names.most_common(1)[0][0]!r}"
        raise DataError("the scene's trajectory", found, "give each generated set a name of its own")
    return views


def _drawn_views(scene: Scene, approach: Approach) -> Iterator[RingView]:
    """Distance by distance, pose by pose, light by light."""
    generator = np.random.default_rng([scene.seed, approach.seed])
    for distance_m in approach.distances_m:
        for number in range(approach.count):
            normal, center_m = _drawn_pose(scene, approach, distance_m, generator)
            for light in approach.lights:
                yield RingView(
                    name=f"{approach.name}{1000 * distance_m:04.0f}_p{number:02d}_{light}",
                    center_m=center_m,
                    normal=normal,
                    light=light,
                    groups={"distance_m": distance_m},
                )


def _drawn_pose(
    scene: Scene, approach: Approach, distance_m: float, generator: np.random.Generator
) -> tuple[Float64[Array, "3"], Float64[Array, "3"]]:
    """Normal and centre: a point in the middle of the ring's band lies near the optical axis at that depth."""
    pitch_rad, yaw_rad = generator.uniform(-1, 1, 2) * approach.tilt_rad
    normal = facing_normal(pitch_rad, yaw_rad)
    side, clock_rad = generator.choice([-1.0, 1.0]), generator.uniform(-1, 1) * approach.clock_rad
    seen = distance_m * picture_ray(scene.rig.camera, approach.offset * generator.uniform(-1, 1, 2))
    axes = ring_rotation(normal, 0.0)
    outward = side * (np.cos(clock_rad) * axes[:, 0] + np.sin(clock_rad) * axes[:, 1])
    return normal, seen - (scene.ring.radius_inner_m + scene.ring.radius_outer_m) / 2 * outward


def picture_ray(camera: Camera, offset: Float64[Array, "xy=2"]) -> Float64[Array, "xyz=3"]:
    """The ray through the picture's middle, moved by shares of its width and height."""
    size = np.array([camera.image_width, camera.image_height], dtype=np.float64)
    return rays((size - 1) / 2 + offset * size, camera)
