"""Maps of the bound are what drawn shots show; sweeps change what they name."""

from dataclasses import replace
from itertools import islice
from math import degrees, inf, radians
from pathlib import Path

import numpy as np
import pytest
from calibrated import chi_squared

from ringpose.bench.design.maps import (
    Place,
    best,
    designs,
    place_result,
    places,
    scene_at,
)
from ringpose.bench.design.rig_changes import with_changes
from ringpose.estimate.nuisance import with_stability
from ringpose.files.scenes.scene import read_scene
from ringpose.measure.stream import Setup
from ringpose.simulate.features import Deviations, drawn_features
from ringpose.simulate.pipeline import simulated_shot
from ringpose.types.assumptions import NOISE_ONLY, TYPICAL_STABILITY, AssumptionOptions, RigStability

EXAMPLE = Path(__file__).parents[3] / "examples" / "scene.yaml"
STILL = RigStability()


@pytest.fixture(scope="module")
def scene():
    return read_scene(EXAMPLE)


@pytest.fixture(scope="module")
def uncertain(scene):
    return replace(scene, rig=with_stability(scene.rig, TYPICAL_STABILITY))


def is_as_mapped(scene, place, shots, *, rendered=False):
    """Whether all shots have a pose, and the centre's RMS error over that of the map is in its 99 % band.

    Shots are drawn with the errors of the rig, or rendered and measured with noise only.
    """
    at_place, errors_m = scene_at(scene, place), []
    for seed in range(shots):
        seeded = replace(at_place, seed=seed)
        if rendered:
            source, _ = simulated_shot(seeded, seeded.views, 0)
        else:
            source = next(drawn_features(seeded, Deviations(rig_errors=True), 1)).detection
        setup = Setup(rig=scene.rig, options=NOISE_ONLY if rendered else AssumptionOptions())
        pose = setup.measure(source).pose
        errors_m.append(np.inf if pose is None else np.linalg.norm(pose.center_m - at_place.views[0].center_m))
    ratio = np.sqrt(np.mean(np.square(errors_m))) / place_result(scene, place).sd["center_m"]
    low, high = np.sqrt(chi_squared([0.005, 0.995], shots) / shots)  # along one direction, the widest band
    return low < ratio < high


def random_places(scene, rng):
    """Places that a map does not hatch."""
    while True:
        place = Place(
            distance_m=float(rng.uniform(0.3, 1.0)),
            offset_x=float(rng.uniform(-0.2, 0.2)),
            pitch_rad=float(rng.uniform(-0.15, 0.15)),
            yaw_rad=float(rng.uniform(-0.15, 0.15)),
        )
        if not place_result(scene, place).above_bound("center_m"):
            yield place


def test_drawn_shots_have_the_errors_of_the_map_at_a_place(uncertain):
    assert is_as_mapped(uncertain, Place(distance_m=0.5, pitch_rad=0.1), 25)


@pytest.mark.slow
def test_drawn_shots_have_the_errors_of_the_map_at_random_places(uncertain, rng):
    found = [is_as_mapped(uncertain, place, 50) for place in islice(random_places(uncertain, rng), 20)]

    assert sum(found) >= 18


@pytest.mark.slow
def test_rendered_shots_have_the_errors_of_the_map_where_it_is_not_hatched(scene, rng):
    assert all(is_as_mapped(scene, place, 25, rendered=True) for place in islice(random_places(scene, rng), 2))


def test_a_map_is_hatched_where_the_stripe_on_the_body_is_beside_that_on_the_face(scene):
    near, far = Place(distance_m=0.4), Place(distance_m=0.7)

    assert not place_result(scene, near).above_bound("grasp_m")
    assert place_result(scene, far).above_bound("grasp_m")
    assert not place_result(replace(scene, body=None), far).above_bound("grasp_m")


def test_known_radii_and_a_stable_rig_lower_the_bound(scene, uncertain):
    place = Place(distance_m=0.5)
    exact = place_result(scene, place)

    assert exact.sd["center_known_m"] < 0.5 * exact.sd["center_m"]
    assert exact.sd["normal_rad"] < place_result(uncertain, place).sd["normal_rad"]
    assert exact.stripes == 3
    assert not exact.weak


def test_a_stripe_that_leaves_the_image_is_counted_and_leaves_the_centre_open(scene):
    result = place_result(scene, Place(distance_m=0.15))

    assert result.stripes < 3
    assert result.weak
    assert not result.sd["center_m"] < 0.1


def test_stripes_that_nearly_cross_are_ambiguous_in_a_single_frame(scene):
    near = place_result(with_changes(scene, {"laser_angle_rad": 0.002}), Place(distance_m=0.5))
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
    changed = with_changes(scene, {name: value})

    assert found(changed.rig) == pytest.approx(value)
    lasers = changed.rig.lasers
    assert (lasers.normal * lasers.projector_m).sum(axis=1) == pytest.approx(lasers.distance_m)
    assert np.linalg.norm(lasers.normal, axis=1) == pytest.approx(1.0)
    assert len({step for step in changed.sequence if step}) >= len(lasers.names)


def test_more_lasers_over_the_same_angle_improve_the_centre(scene):
    three, five = (place_result(with_changes(scene, {"lasers": n}), Place(distance_m=0.5)) for n in (3.0, 5.0))

    assert five.stripes == 5
    assert five.sd["center_m"] < three.sd["center_m"]
    assert degrees(five.sd["normal_rad"]) < degrees(three.sd["normal_rad"])
