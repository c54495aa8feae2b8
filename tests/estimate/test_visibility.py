"""How well break points are predicted from a ring and its covariance, by sampling."""

import numpy as np
from ring_scenes import make_scene

from ringpose.estimate.visibility import break_point_sigmas_px
from ringpose.geometry.rays import project
from ringpose.geometry.ring import predicted_break_points, ring_arcs

STEP_SD = np.array([2e-3, 4e-3, 3e-3, 2e-4, 1e-4, 0.02, 1e-4])


def test_the_sigmas_of_predicted_break_points_are_those_of_drawn_rings(rng):
    scene = make_scene("B", distance_m=0.5, tilt_rad=(0.2, -0.15), turn_rad=0.3)
    lasers, camera = scene.rig.lasers, scene.rig.camera
    ring = scene.ring
    arcs = ring_arcs(ring.center_m, ring.normal, ring.radius_m, scene.points_m.mean(axis=(0, 1)))
    predicted_m = predicted_break_points(arcs, lasers.normal, lasers.distance_m)

    sigma_px = break_point_sigmas_px(arcs, np.diag(STEP_SD**2), predicted_m, scene.rig)

    steps = STEP_SD * rng.normal(size=(2000, 7))
    rings = [predicted_break_points(arcs.retract(step), lasers.normal, lasers.distance_m) for step in steps]
    drawn_px = project(np.array(rings), camera)
    np.testing.assert_allclose(sigma_px[..., 0], drawn_px[..., 0].std(axis=0), rtol=0.1)
