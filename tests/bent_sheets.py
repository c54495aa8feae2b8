"""Rings before light planes that are bent: break points by their definition, without the code under test."""

from dataclasses import replace

import numpy as np
from ring_scenes import PROJECTED, RIGS, Ring, face_points_of, line_of_face, pixels_of, scene_of

from ringpose.types.rig import LaserBow, LaserPlanes, Rig

BOW_PER_RAD = np.array([0.0114, 0.0, -0.008])
"""A millimetre at 0.5 m, 24 degrees beside the middle; the second plane is flat."""


def bent_rig(bow_per_rad=BOW_PER_RAD, **changed) -> Rig:
    """Rig B, whose projectors are known, with these bows."""
    bows = {
        name: LaserBow(per_rad=bow, sd_per_rad=1e-4)
        for name, bow in zip(PROJECTED.names, np.asarray(bow_per_rad).tolist(), strict=True)
        if bow
    }
    return replace(RIGS["B"], lasers=PROJECTED, bows=bows, **changed)


def elevation_m(points: np.ndarray, laser: int, rig: Rig) -> np.ndarray:
    """Distance of points from a laser's bent sheet, along the normal of its plane."""
    lasers = rig.lasers
    normal = lasers.normal[laser]
    axis = np.array([0.0, 0.0, 1.0]) - normal[2] * normal
    axis /= np.linalg.norm(axis)
    along, aside = ((points - lasers.projector_m[laser]) @ each for each in (axis, np.cross(normal, axis)))
    bow = rig.bows[lasers.names[laser]].per_rad if lasers.names[laser] in rig.bows else 0.0
    return points @ normal - lasers.distance_m[laser] - bow * np.hypot(along, aside) * np.arctan2(aside, along) ** 2


def bent_crossings_m(ring: Ring, rig: Rig) -> np.ndarray:
    """Where the bent sheets meet the ring's edges: about the places where the planes do, by Newton's method."""
    flat_m = ring.break_points_m(LaserPlanes(**{name: getattr(rig.lasers, name) for name in LaserPlanes.__slots__}))
    first = np.cross(ring.normal, [0.3, 1.0, 0.2])
    axes = np.stack([first / np.linalg.norm(first), np.cross(ring.normal, first / np.linalg.norm(first))])
    points_m = np.empty_like(flat_m)
    for laser, edge in np.ndindex(flat_m.shape[:2]):
        x, y = axes @ (flat_m[laser, edge] - ring.center_m)
        angle = np.arctan2(y, x) + np.array([-1e-6, 0.0, 1e-6])
        for _ in range(8):
            circle = ring.center_m + ring.radius_m[edge] * np.stack([np.cos(angle), np.sin(angle)], axis=1) @ axes
            before, at, after = elevation_m(circle, laser, rig)
            angle = angle - at * 2e-6 / (after - before)
        points_m[laser, edge] = circle[1]
    return points_m


def bent_features(ring: Ring, rig: Rig, sigma_px: float, line_px: float, rng=None):
    """Break points, and straight lines fitted to the bent stripes between them, as `face_points_of` flat ones."""
    scene = scene_of(rig, ring, bent_crossings_m(ring, rig))
    inside = [
        bent_crossings_m(replace(ring, radius_m=ring.radius_m[0] + np.ptp(ring.radius_m) * np.array([a, b])), rig)
        for a, b in ((0.0, 1.0), (1 / 3, 2 / 3))
    ]
    camera = replace(rig.camera, distortion_coefficients=np.zeros(5))
    stripes_px = pixels_of(np.concatenate(inside, axis=1), camera)
    features = face_points_of(scene, sigma_px, line_px, rng)
    fitted = []
    for stripe in stripes_px:  # a cubic polynomial is the stripe to 1e-6 px; a line is fitted to many centres of it
        x = np.linspace(stripe[:, 0].min(), stripe[:, 0].max(), 1001)
        fitted.append(np.polynomial.Polynomial.fit(x, np.polynomial.Polynomial.fit(*stripe.T, 3)(x), 1))
    ends = {}
    for name in ("face_start_undistorted_px", "face_end_undistorted_px"):
        drawn = getattr(features, name)  # their noise is that of the line through both break points
        exact = np.array([line_of_face(scene, laser) for laser in range(3)])[:, int("end" in name)]
        ends[name] = drawn + [[0.0, line(x) - y] for line, (x, y) in zip(fitted, exact, strict=True)]
    return replace(features, **ends)
