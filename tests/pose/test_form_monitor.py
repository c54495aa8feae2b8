"""The radii of a stream of shots show that a ring is not round, where a single shot cannot."""

from dataclasses import replace

import numpy as np
import pytest

from ringpose.files.scenes.scene import read_scene
from ringpose.files.studies.specification import PRESETS
from ringpose.measure.stream import pose_line
from ringpose.pose.rig_monitor import FormMonitor
from ringpose.simulate.features import drawn_features
from ringpose.types.pose import KnownRadii, PoseFlag
from ringpose.types.scene import Approach
from ringpose.types.target import RingForm


@pytest.fixture(scope="module")
def shot():
    """In light without a flag."""
    scene = read_scene(PRESETS / "paper-physical-scene.yaml")
    view = Approach(count=1, distances_m=(0.5,), lights=("normal",), seed=3, name="r", tilt_rad=0.15)
    (drawn,) = drawn_features(replace(scene, views=(), approaches=(view,)))
    return drawn.detection, scene.rig


@pytest.fixture
def line(shot):
    found = pose_line(*shot)
    assert found.status == "ok"
    return found


def with_radii(line, radius_m):
    pose = replace(line.pose, radius_inner_m=float(radius_m[0]), radius_outer_m=float(radius_m[1]))
    return replace(line, pose=pose)


def monitored(lines):
    monitor = FormMonitor()
    return [monitor.update(each) for each in lines]


def stream(line, rng, shots, offset_m=(0.0,)):
    """Lines with errors of the radii as stated, and with the radii of one place after the other."""
    radius_m = np.array([line.pose.radius_inner_m, line.pose.radius_outer_m])
    errors_m = rng.multivariate_normal(np.zeros(2), line.pose.covariance[5:7, 5:7], size=shots)
    return [with_radii(line, radius_m + errors_m[n] + offset_m[n % len(offset_m)]) for n in range(shots)]


def test_radii_that_differ_between_shots_are_flagged_with_the_remedy(line, rng):
    sd_m = np.sqrt(line.pose.covariance[6, 6])
    found = monitored(stream(line, rng, 12, 8 * sd_m * np.array([0.0, 1.0, -1.0])))

    warnings = [warning for _, warning in found if warning]
    assert len(warnings) == 1
    assert "--ring-tolerance" in warnings[0]
    assert {"ring_form", "inconsistent"} <= set(found[-1][0].flag_names)
    assert found[-1][0].status == "degraded"


@pytest.mark.parametrize("streams", [8, pytest.param(40, marks=pytest.mark.slow)])
def test_radii_within_their_errors_are_not_flagged(line, rng, streams):
    for _ in range(streams):
        found = monitored(stream(line, rng, 50))

        assert all(warning is None for _, warning in found)
        assert found[-1][0].flags == line.flags


def test_a_single_shot_with_another_radius_is_not_evidence(line, rng):
    lines = stream(line, rng, 20)
    lines[7] = with_radii(line, np.array([0.55, 0.58]))

    assert all(warning is None for _, warning in monitored(lines))


def test_a_few_wrong_shots_are_not_evidence(line, rng):
    sd_m = np.sqrt(line.pose.covariance[6, 6])
    lines = stream(line, rng, 50)
    for place, sigmas in ((5, -9.0), (17, 8.0), (30, -7.0)):
        radius_m = [lines[place].pose.radius_inner_m, lines[place].pose.radius_outer_m]
        lines[place] = with_radii(line, radius_m + sigmas * sd_m)

    assert all(warning is None for _, warning in monitored(lines))


def test_another_ring_is_not_compared(line, rng):
    radius_m = np.array([0.438, 0.468])
    lines = [*stream(line, rng, 6), *(with_radii(line, radius_m) for _ in range(6)), *stream(line, rng, 6)]

    assert all(warning is None for _, warning in monitored(lines))


def test_given_radii_show_nothing(shot, rng):
    given = pose_line(*shot, known=KnownRadii(radius_m=np.array([0.567, 0.597]), sd_m=np.full(2, 5e-4)))
    sd_m = np.sqrt(given.pose.covariance[6, 6])

    found = monitored(stream(given, rng, 12, 30 * sd_m * np.array([0.0, 1.0, -1.0])))

    assert all(warning is None for _, warning in found)


@pytest.mark.slow
def test_a_ring_that_is_out_of_round_is_flagged_when_it_is_seen_from_several_places():
    flagged = {}
    for order in (0, 4):
        scene = read_scene(PRESETS / "paper-physical-scene.yaml")
        radial_m = np.zeros((2, 3, 2))
        radial_m[:, order - 2] = (0.0012, 0.0) if order else 0.0
        ring = replace(scene.ring, form=RingForm(radial_m=radial_m, axial_m=np.zeros((3, 2))))
        views = tuple(
            Approach(
                count=8, distances_m=(each,), lights=("normal",), seed=3, name=f"r{each}", tilt_rad=0.2, clock_rad=0.5
            )
            for each in (0.5, 0.8)
        )
        scene = replace(scene, ring=ring, views=(), approaches=views)
        found = monitored(pose_line(shot.detection, scene.rig) for shot in drawn_features(scene))
        flagged[order] = any(PoseFlag.RING_FORM in each.flags for each, _ in found)

    assert flagged == {0: False, 4: True}
