"""Maps of the bound are what drawn shots show; sweeps change what they name."""

from dataclasses import replace
from math import degrees, inf, radians
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import chi2

from ringpose.bench.design.maps import (
    Place,
    best,
    designs,
    place_result,
    places,
    scene_at,
    scene_with,
)
from ringpose.estimate.nuisance import with_stability
from ringpose.files.scenes.scene import read_scene
from ringpose.pose.pipeline import pose_line
from ringpose.simulate.features import Deviations, drawn_features
from ringpose.types.assumptions import TYPICAL_STABILITY, RigStability

EXAMPLE = Path(__file__).parents[3] / "examples" / "scene.yaml"
STILL = RigStability()


@pytest.fixture(scope="module")
def scene():
    return read_scene(EXAMPLE)


def ratio_and_band(scene, place, shots):
    """Root mean square centre error of drawn shots over the map's value, and the 99 % band of this ratio.

    The square sum is treated as chi-squared with as many degrees of freedom as one direction gives, the widest band.
    """
    at_place = scene_at(scene, place)
    errors = []
    for seed in range(shots):
        shot = next(drawn_features(replace(at_place, seed=seed), Deviations(rig_errors=True), 1))
        errors.append(np.linalg.norm(pose_line(shot.detection, scene.rig).pose.center_m - shot.truth.center_m))
    ratio = np.sqrt(np.mean(np.square(errors))) / place_result(scene, place).sd["center_m"]
    return ratio, np.sqrt(chi2.ppf([0.005, 0.995], shots) / shots)


def random_places(scene, rng, count):
    """Places at which the estimator does not flag the pose as weak."""
    found = []
    while len(found) < count:
        place = Place(
            distance_m=float(rng.uniform(0.3, 1.0)),
            offset_x=float(rng.uniform(-0.2, 0.2)),
            pitch_rad=float(rng.uniform(-0.15, 0.15)),
            yaw_rad=float(rng.uniform(-0.15, 0.15)),
        )
        if not place_result(scene, place).weak:
            found.append(place)
    return found


def test_drawn_shots_have_the_errors_of_the_map_at_a_place(scene):
    uncertain = replace(scene, rig=with_stability(scene.rig, TYPICAL_STABILITY))

    ratio, (low, high) = ratio_and_band(uncertain, Place(distance_m=0.5, pitch_rad=0.1), 25)

    assert low < ratio < high


@pytest.mark.slow
def test_drawn_shots_have_the_errors_of_the_map_at_random_places(scene, rng):
    uncertain = replace(scene, rig=with_stability(scene.rig, TYPICAL_STABILITY))

    found = [ratio_and_band(uncertain, place, 50) for place in random_places(uncertain, rng, 20)]

    inside = [low < ratio < high for ratio, (low, high) in found]
    assert sum(inside) >= 18


def test_known_radii_and_a_stable_rig_lower_the_bound(scene):
    place = Place(distance_m=0.5)
    exact = place_result(scene, place)
    uncertain = place_result(replace(scene, rig=with_stability(scene.rig, TYPICAL_STABILITY)), place)

    assert exact.sd["center_known_m"] < 0.5 * exact.sd["center_m"]
    assert exact.sd["normal_rad"] < uncertain.sd["normal_rad"]
    assert exact.stripes == 3
    assert not exact.weak


def test_a_stripe_that_leaves_the_image_is_counted_and_leaves_the_centre_open(scene):
    result = place_result(scene, Place(distance_m=0.15))

    assert result.stripes < 3
    assert result.weak
    assert not result.sd["center_m"] < 0.1


def test_stripes_that_nearly_cross_are_ambiguous_in_a_single_frame(scene):
    near = place_result(scene_with(scene, {"laser_angle_rad": 0.002}), Place(distance_m=0.5))
    wide = place_result(scene, Place(distance_m=0.5))

    assert near.weak
    assert not wide.ambiguous


def test_a_sweep_tries_all_combinations_beside_the_papers_angles(scene):
    found = list(designs(scene, {"laser_angle_rad": [0.1, 0.15], "baseline_m": [0.06]}, places([0.5], [0.0]), STILL))

    assert [design.reference for design in found] == [False, False, False, True, True]
    assert [design.changes for design in found[1:3]] == [
        {"laser_angle_rad": 0.1, "baseline_m": 0.06},
        {"laser_angle_rad": 0.15, "baseline_m": 0.06},
    ]
    narrow, wide = found[3:]
    assert narrow.median("center_m") > 3 * wide.median("center_m")
    chosen = best(found, "center_m", 0.5)
    assert chosen.median("center_m") == min(each.median("center_m") for each in found[:3])


def test_no_rig_is_chosen_that_does_not_cover_the_places(scene):
    found = list(designs(scene, {}, places([0.1], [0.0]), STILL))

    assert best(found, "center_m", 1.0) is None
    assert found[0].full_view_m() is None
    assert found[0].median("center_m") == inf


@pytest.mark.parametrize(
    ("name", "value", "found"),
    [
        ("baseline_m", 0.09, lambda rig: np.linalg.norm(rig.lasers.projector_m[:, :2], axis=1).mean()),
        ("focal_px", 500.0, lambda rig: rig.camera.camera_matrix[0, 0]),
        ("lasers", 5.0, lambda rig: len(rig.lasers.names)),
        ("laser_angle_rad", radians(4), lambda rig: np.arctan2(*rig.lasers.normal[-1, [2, 1]])),
    ],
)
def test_a_change_of_the_rig_is_what_it_names_and_planes_contain_their_projectors(scene, name, value, found):
    changed = scene_with(scene, {name: value})

    assert found(changed.rig) == pytest.approx(value)
    lasers = changed.rig.lasers
    assert (lasers.normal * lasers.projector_m).sum(axis=1) == pytest.approx(lasers.distance_m)
    assert np.linalg.norm(lasers.normal, axis=1) == pytest.approx(1.0)
    assert len({step for step in changed.sequence if step}) >= len(lasers.names)


def test_more_lasers_over_the_same_angle_improve_the_centre(scene):
    three, five = (place_result(scene_with(scene, {"lasers": n}), Place(distance_m=0.5)) for n in (3.0, 5.0))

    assert five.stripes == 5
    assert five.sd["center_m"] < three.sd["center_m"]
    assert degrees(five.sd["normal_rad"]) < degrees(three.sd["normal_rad"])
