"""Scenes that differ from a given one: in their rig, lens, sensor, ring, surfaces or laser steps."""

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from ringpose.errors import DataError
from ringpose.geometry.ring import rotation_by
from ringpose.types.arrays import Array, Float64
from ringpose.types.rig import LaserPlanes, Rig
from ringpose.types.scene import Scene
from ringpose.types.session import parsed_sequence
from ringpose.types.study import Surface
from ringpose.types.target import sloping


def with_changes(scene: Scene, values: Mapping[str, Any]) -> Scene:
    """The scene with those of the values that `CHANGES` names."""
    for name, change in CHANGES.items():
        if name in values:
            scene = change(scene, values[name])
    return scene


def _with_lasers(scene: Scene, count: float) -> Scene:
    """A scene whose shots show each laser alone, and all together."""
    number = round(count)
    sequence = (0, *(1 << laser for laser in range(number)), (1 << number) - 1)
    return replace(scene, rig=with_lasers(scene.rig, number), sequence=sequence)


def _with_radius(scene: Scene, radius_outer_m: float) -> Scene:
    """A ring of the same cross-section."""
    larger_m = np.array([radius_outer_m - scene.ring.radius_outer_m, 0.0])
    return replace(scene, ring=replace(scene.ring, profile_m=scene.ring.profile_m + larger_m))


def _with_sequence(scene: Scene, text: str) -> Scene:
    lasers = len(scene.rig.lasers.names)
    return replace(scene, sequence=tuple(step.mask(lasers) for step in parsed_sequence(text)))


CHANGES: Mapping[str, Callable[[Scene, Any], Scene]] = {
    "lasers": _with_lasers,
    "baseline_m": lambda scene, value: replace(scene, rig=with_baseline(scene.rig, value)),
    "focal_px": lambda scene, value: replace(scene, rig=with_focal_length(scene.rig, value)),
    "laser_angle_rad": lambda scene, value: replace(scene, rig=with_laser_angle(scene.rig, value)),
    "ring_radius_outer_m": _with_radius,
    "sequence": _with_sequence,
    "stripe_dn": lambda scene, value: replace(scene, stripe_dn=value),
    "blur_px": lambda scene, value: replace(scene, lens=replace(scene.lens, blur_px=value)),
    "speckle_contrast": lambda scene, value: replace(scene, speckle=replace(scene.speckle, contrast=value)),
    "dark_noise_e": lambda scene, value: replace(scene, sensor=replace(scene.sensor, temporal_dark_noise_e=value)),
}
"""What differs in a sweep of rigs, or in a study, in the order in which it is changed."""


def with_surface(scene: Scene, surface: Surface) -> Scene:
    """The scene with a ghost, bent sheets, another face, gaps and obstacles, in addition to those that it has."""
    lasers, ring = scene.lasers, scene.ring
    changed = replace(ring, face=ring.face if surface.face is None else surface.face, gaps=(*ring.gaps, *surface.gaps))
    return replace(
        scene,
        lasers=replace(
            lasers, ghost=surface.ghost or lasers.ghost, bow_per_rad=lasers.bow_per_rad + surface.bow_per_rad
        ),
        ring=sloping(changed, surface.slope_rad),
        obstacles=(*scene.obstacles, *surface.obstacles),
    )


def elevations_rad(planes: LaserPlanes) -> Float64[Array, "laser"]:
    """Rotation of each light plane about the camera's x axis; 0 for a plane that contains the viewing direction."""
    elevation: Float64[Array, "laser"] = np.arctan2(planes.normal[:, 2], planes.normal[:, 1])
    return elevation


def with_laser_angle(rig: Rig, angle_rad: float) -> Rig:
    """The rig with its light planes spread evenly from -angle to +angle, each turned about its projector.

    They keep their order. The covariance, if there is one, is kept: calibration is as accurate as before.
    """
    order = np.argsort(elevations_rad(rig.lasers))
    target = np.zeros(len(order))
    target[order] = np.linspace(-angle_rad, angle_rad, len(order)) if len(order) > 1 else 0.0
    turns_rad = np.array([[1.0, 0.0, 0.0]]) * (target - elevations_rad(rig.lasers))[:, None]
    normal = (rotation_by(turns_rad) @ rig.lasers.normal[..., None])[..., 0]
    return replace(rig, lasers=_through_projectors(replace(rig.lasers, normal=normal)))


def with_baseline(rig: Rig, baseline_m: float) -> Rig:
    """The rig with its projectors moved across the optical axis, on average `baseline_m` away from it."""
    across_m = rig.lasers.projector_m[:, :2]
    mean_m = float(np.linalg.norm(across_m, axis=1).mean())
    if not mean_m > 0:
        raise DataError("rig", "its projectors lie on the optical axis", "give lasers beside the camera")
    projector_m = rig.lasers.projector_m.copy()
    projector_m[:, :2] = across_m * baseline_m / mean_m
    return replace(rig, lasers=_through_projectors(replace(rig.lasers, projector_m=projector_m)))


def with_lasers(rig: Rig, count: int) -> Rig:
    """The rig with this number of lasers: light planes spread evenly over the same range, projectors interpolated."""
    elevation = elevations_rad(rig.lasers)
    order = np.argsort(elevation)
    place = np.linspace(0, len(order) - 1, count) if count > 1 else np.array([(len(order) - 1) / 2])
    projector_m = np.stack(
        [np.interp(place, np.arange(len(order)), rig.lasers.projector_m[order, axis]) for axis in range(3)], axis=1
    )
    angle = np.interp(place, np.arange(len(order)), elevation[order])
    normal = np.stack([np.zeros(count), np.cos(angle), np.sin(angle)], axis=1)
    lasers = LaserPlanes(
        names=tuple(f"laser_{number}" for number in range(1, count + 1)),
        normal=normal,
        distance_m=np.zeros(count),
        projector_m=projector_m,
    )
    return replace(rig, lasers=_through_projectors(lasers), covariance=None)


def with_focal_length(rig: Rig, focal_px: float) -> Rig:
    """The rig with another lens, of this focal length in x; distortion is left out, as it belongs to the old lens."""
    matrix = rig.camera.camera_matrix.copy()
    matrix[1, 1] *= focal_px / matrix[0, 0]
    matrix[0, 0] = focal_px
    coefficients = np.zeros_like(rig.camera.distortion_coefficients)
    return replace(rig, camera=replace(rig.camera, camera_matrix=matrix, distortion_coefficients=coefficients))


def _through_projectors(planes: LaserPlanes) -> LaserPlanes:
    """The planes moved so that each contains its projector."""
    return replace(planes, distance_m=(planes.normal * planes.projector_m).sum(axis=1))
