"""Runs of shots of a moving target: every shot shows it on its path, and a track is better than its last shot."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from ringpose.bench.study.shots import scene_of, study_rows, with_run
from ringpose.files.scenes.scene import read_scene
from ringpose.simulate.features import Deviations, drawn_features
from ringpose.types.assumptions import MotionPrior
from ringpose.types.study import Factor, ShotRun, Study, StudyMethod

EXAMPLE = Path(__file__).parents[3] / "examples" / "scene.yaml"
PRIOR = MotionPrior(speed_sd_m_s=0.02, rate_sd_rad_s=0.03)
RUN = ShotRun(shots=3, period_s=0.25)


@pytest.fixture(scope="module")
def study():
    return Study(
        title="test",
        scene=read_scene(EXAMPLE),
        level="features",
        count=1,
        seed=3,
        factors=(
            Factor(name="distance_m", values=(0.5,)),
            Factor(name="speed_sd_m_s", values=(0.0, 0.01)),
            Factor(name="rate_sd_rad_s", values=(0.0, 0.01)),
        ),
        methods=(StudyMethod.ML, StudyMethod.TRACK),
        table="distance_m",
        run=RUN,
    )


def test_each_laser_of_a_moving_target_shows_it_where_it_is_at_its_frame(study, rng):
    single = replace(study, run=ShotRun())
    moving = with_run(scene_of(single, 0, {"distance_m": 0.5}), RUN, PRIOR, rng)

    drawn = list(drawn_features(moving, Deviations(noise=False)))

    assert len(drawn) == RUN.shots
    for number in (0, RUN.shots - 1):
        view, shot = moving.views[number], drawn[number]
        points = shot.detection.break_points
        for laser, stamp_s in enumerate(points.stamp_s):
            passed_s = stamp_s - moving.start_s - number * RUN.period_s
            rotation, translation_m = view.path.camera_from_target(view.begin_s + passed_s)
            center_m = rotation @ [0.0, 0.0, moving.ring.height_m] + translation_m
            still = replace(view, path=None, center_m=center_m, normal=rotation[:, 2])
            seen = next(drawn_features(replace(moving, views=(still,)), Deviations(noise=False)))
            assert points.position_px[laser] == pytest.approx(seen.detection.break_points.position_px[laser], abs=1e-3)


def test_the_last_shot_of_a_run_is_in_the_pose_of_the_factors(study):
    setting = {"distance_m": 0.5, "speed_sd_m_s": 0.01, "rate_sd_rad_s": 0.01}
    single = scene_of(replace(study, run=ShotRun()), 0, setting).views[-1]

    first, *_, last = scene_of(study, 0, setting).views

    assert last.center_m == pytest.approx(single.center_m)
    assert last.normal == pytest.approx(single.normal)
    assert 0.001 < np.linalg.norm(first.center_m - last.center_m) < 0.1


def test_a_track_of_three_shots_is_better_than_the_last_one(study):
    rows = [row for index in range(study.shots) for row in study_rows(study, index)]

    by_method = {method: [row for row in rows if row["method"] == method] for method in ("ml", "track")}
    rms = {method: np.sqrt(np.mean([row["normal_rad"] ** 2 for row in found])) for method, found in by_method.items()}
    assert rms["track"] < 0.8 * rms["ml"]
    assert all(row["wrong"] == "" and row["status"] != "none" for row in by_method["track"])
    assert all((row["velocity_m_s"] is None) == (index % 4 == 0) for index, row in enumerate(by_method["ml"]))
