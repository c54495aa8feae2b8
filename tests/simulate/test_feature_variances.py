"""Poses from drawn features and poses from images have the same errors: the error model has all terms that matter."""

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from ringpose.detect.pipeline import detect
from ringpose.files.scenes.scene import read_scene
from ringpose.geometry.rotations import tilt_basis
from ringpose.measure.stream import estimate_pose
from ringpose.simulate.features import Deviations, draw_detection
from ringpose.simulate.pipeline import simulate
from ringpose.simulate.placement import ring_views
from ringpose.types.detection import BreakPointFlag
from ringpose.types.pose import PoseFlag
from ringpose.types.scene import Approach

SCENE = Path(__file__).parents[2] / "examples" / "scene.yaml"
POSES = 200
DRAWS = 4
"""Drawn shots of each pose."""

QUANTITIES = (
    "center x", "center y", "center z", "tilt 1", "tilt 2", "inner radius", "outer radius", "grasp normal",
    "grasp radial",
)  # fmt: skip


def cropped_scene():
    """A coarse camera that sees little beyond the stripes, and a body without foil, which are faster to render."""
    scene = read_scene(SCENE)
    camera = scene.rig.camera
    matrix = (camera.camera_matrix - [[0.0, 0.0, 220.0], [0.0, 0.0, 30.0], [0.0, 0.0, 0.0]]) * [[0.7], [0.7], [1.0]]
    camera = replace(camera, image_width=252, image_height=280, camera_matrix=matrix)
    approach = Approach(count=POSES // 2, distances_m=(0.35, 0.45), seed=5)
    return replace(
        scene,
        rig=replace(scene.rig, camera=camera),
        body=replace(scene.body, foil=None),
        sensor=replace(scene.sensor, pixel_m=scene.sensor.pixel_m / 0.7),
        views=(),
        approaches=(approach,),
        sequence=(0, 1, 2, 4),
    )


def errors(pose, view, radius_m):
    tilts = tilt_basis(view.normal) @ pose.normal
    offset = pose.grasp_m - view.center_m
    height_m = offset @ view.normal
    radial_m = np.linalg.norm(offset - height_m * view.normal) - radius_m.mean()
    radii = [pose.radius_inner_m - radius_m[0], pose.radius_outer_m - radius_m[1]]
    return np.array([*(pose.center_m - view.center_m), *tilts, *radii, height_m, radial_m])


def standard_deviations(pose, view):
    offset = pose.grasp_m - view.center_m
    outward = offset - (offset @ view.normal) * view.normal
    outward /= np.linalg.norm(outward)
    grasp = [axis @ pose.covariance_grasp_m2 @ axis for axis in (view.normal, outward)]
    return np.sqrt([*np.diag(pose.covariance_center_m2), *np.diag(pose.covariance)[[0, 1, 5, 6]], *grasp])


@pytest.mark.slow
def test_pose_errors_from_images_and_from_drawn_features_have_the_same_variances(rng):
    scene = cropped_scene()
    radius_m = np.array([scene.ring.radius_inner_m, scene.ring.radius_outer_m])
    from_images, from_features = [], []
    for view, (shot, _) in zip(ring_views(scene), simulate(scene, jobs=2), strict=True):
        found = detect(shot, scene.rig, edges=False).break_points
        exact = draw_detection(scene, view, rng, Deviations(noise=False)).detection.break_points
        if not (found.seen.all() and exact.seen.all()) or (found.flags & BreakPointFlag.EDGE_UNKNOWN).any():
            continue
        sigma = standard_deviations(estimate_pose(exact, scene.rig), view)  # of each pose, so that all weigh the same
        pose = estimate_pose(found, scene.rig)
        if PoseFlag.NORMAL_WEAK in pose.flags:  # a shot has another explanation, which one of 300 has by chance
            continue
        from_images.append(errors(pose, view, radius_m) / sigma)
        for _ in range(DRAWS):
            drawn = draw_detection(scene, view, rng, Deviations()).detection.break_points
            from_features.append(errors(estimate_pose(drawn, scene.rig), view, radius_m) / sigma)

    image, feature = np.mean(np.square(from_images), axis=0), np.mean(np.square(from_features), axis=0)
    table = [f"{'':<14}{'images':>8}{'features':>10}{'ratio':>8}   (variances in units of the stated ones)"]
    for name, first, second in zip(QUANTITIES, image, feature, strict=True):
        table.append(f"{name:<14}{first:8.2f}{second:10.2f}{first / second:8.2f}")
    sys.stdout.write("\n".join(["", *table, ""]))
    assert len(from_images) > 0.9 * POSES
    assert np.abs(np.log(image / feature)).max() < np.log(1.6), "\n".join(table)
