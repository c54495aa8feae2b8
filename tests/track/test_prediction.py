"""The stripes that the next frames should show of a predicted ring."""

from dataclasses import replace

import numpy as np
import pytest
from ring_scenes import make_scene

from ringpose.detect.edge_search import PredictedRing
from ringpose.geometry.ring import ring_arcs
from ringpose.track.prediction import predicted_stripes

SD = np.array([1e-3, 1e-3, 1e-4, 1e-4, 1e-3, 1e-2, 1e-4])


@pytest.mark.parametrize(("inside_px", "seen"), [(5.0, False), (25.0, True)])
@pytest.mark.parametrize(("axis", "upper"), [(0, False), (0, True), (1, False), (1, True)])
def test_an_end_at_the_border_of_the_image_is_not_predicted(axis, upper, inside_px, seen):
    scene = make_scene("A", distance_m=0.5)
    ring, camera = scene.ring, scene.rig.camera
    arcs = ring_arcs(ring.center_m, ring.normal, ring.radius_m, scene.points_m.mean(axis=(0, 1)))
    place_px = scene.position_px[..., axis]
    outermost_px = place_px.max() if upper else place_px.min()
    matrix = camera.camera_matrix.copy()
    size_px = (camera.image_width, camera.image_height)[axis] - 1.0
    matrix[axis, 2] += (size_px - inside_px if upper else inside_px) - outermost_px  # there is no distortion
    rig = replace(scene.rig, camera=replace(camera, camera_matrix=matrix))

    found = predicted_stripes([PredictedRing(arcs, np.diag(SD**2))] * 3, rig)

    assert found.seen[place_px == outermost_px].tolist() == [seen]
    assert found.seen.any()
