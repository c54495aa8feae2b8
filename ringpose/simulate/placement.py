"""Where a target stands before the camera."""

from dataclasses import dataclass

import numpy as np

from ringpose.types.arrays import Array, Float64


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Placement:
    """`point_camera = rotation @ point_target + translation_m`."""

    rotation: Float64[Array, "3 3"]
    translation_m: Float64[Array, "xyz=3"]

    @property
    def eye_m(self) -> Float64[Array, "xyz=3"]:
        """The camera's centre in the target frame."""
        return self.points_target(np.zeros((3, 1)))[:, 0]

    def points_target(self, point_camera: Float64[Array, "xyz=3 n"]) -> Float64[Array, "xyz=3 n"]:
        """Points of the camera frame in the target frame."""
        return self.vectors_target(point_camera - self.translation_m[:, None])

    def points_camera(self, point_target: Float64[Array, "*shape xyz=3"]) -> Float64[Array, "*shape xyz=3"]:
        """Points of the target frame, in rows, in the camera frame."""
        return point_target @ self.rotation.T + self.translation_m

    def vectors_target(self, vector_camera: Float64[Array, "xyz=3 n"]) -> Float64[Array, "xyz=3 n"]:
        """Directions of the camera frame in the target frame."""
        return self.rotation.T @ vector_camera


def ring_rotation(normal: Float64[Array, "3"], roll_rad: float) -> Float64[Array, "3 3"]:
    """Axes of the target frame as columns: z along the normal, x nearest to the camera's x for zero roll."""
    z = normal / np.linalg.norm(normal)
    x = np.array([1.0, 0.0, 0.0]) - z[0] * z
    x /= np.linalg.norm(x)
    y = np.cross(z, x)
    cosine, sine = np.cos(roll_rad), np.sin(roll_rad)
    return np.stack([cosine * x + sine * y, cosine * y - sine * x, z], axis=1)
