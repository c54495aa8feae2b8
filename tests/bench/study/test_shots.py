"""A shot of a study is a function of the study and its index; its rows are at their bound and name failures."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from ringpose.bench.study.shots import ERROR, scene_of, setting_of, shown_by, study_rows, study_shot, with_run
from ringpose.bench.study.table import exceeded_limits, finding, status_table, study_text, summarized, worst_shots
from ringpose.errors import DataError
from ringpose.files.scenes.scene import read_scene
from ringpose.files.studies.specification import read_study, study_path
from ringpose.geometry.rays import project
from ringpose.simulate.features import Deviations, drawn_features
from ringpose.types.assumptions import AssumptionOptions, MotionPrior, RigStability
from ringpose.types.study import TIMES, Factor, ShotRun, Study, StudyMethod, columns

EXAMPLE = Path(__file__).parents[3] / "examples" / "scene.yaml"


@pytest.fixture(scope="module")
def study():
    return Study(
        title="test",
        scene=read_scene(EXAMPLE),
        level="features",
        count=2,
        seed=3,
        factors=(
            Factor(name="distance_m", values=(0.3, 0.5)),
            Factor(name="light", values=("dim", "normal")),
            Factor(name="tilt_rad", uniform=(0.0, 0.2), drawn=True),
        ),
        methods=(StudyMethod.ML, StudyMethod.ML_KNOWN, StudyMethod.PAPER),
        table="distance_m",
    )


@pytest.fixture(scope="module")
def rows(study):
    return [row for index in range(study.shots) for row in study_rows(study, index)]


def without_times(row):
    return {name: value for name, value in row.items() if name not in TIMES}


def test_a_shot_is_the_same_whenever_it_is_computed(study, rows):
    again = study_rows(study, 5)

    assert [without_times(row) for row in again] == [without_times(row) for row in rows if row["shot"] == 5]


def test_shots_differ_from_each_other_and_with_the_seed(study, rows):
    first, second = (row["center_m"] for row in rows if row["method"] == "ml" and row["shot"] in (0, 4))
    other = study_rows(replace(study, seed=4, methods=(StudyMethod.ML,)), 0)[0]["center_m"]

    assert setting_of(study, 0)["distance_m"] == setting_of(study, 4)["distance_m"]
    assert len({first, second, other}) == 3


def test_shots_go_through_the_grid_in_turn_and_draw_the_rest(study):
    settings = [setting_of(study, index) for index in range(study.shots)]

    cells = [(each["distance_m"], each["light"]) for each in settings]
    assert cells[:4] == [(0.3, "dim"), (0.3, "normal"), (0.5, "dim"), (0.5, "normal")]
    assert {cell: cells.count(cell) for cell in cells[:4]} == dict.fromkeys(cells[:4], study.count)
    assert len({each["tilt_rad"] for each in settings}) == study.shots
    assert all(0 <= each["tilt_rad"] <= 0.2 for each in settings)


def test_every_row_has_exactly_the_documented_columns(study, rows):
    types = columns(study)

    assert all(list(row) == list(types) for row in rows)
    wrong = [
        (name, value)
        for row in rows
        for name, value in row.items()
        if value is not None and not isinstance(value, types[name])
    ]
    assert wrong == []
    assert not any(value != value for row in rows for value in row.values())


def test_values_are_drawn_as_often_as_their_shares(study):
    lights = Factor(name="light", values=("dim", "normal"), drawn=True, shares=(0.9, 0.1))
    study = replace(study, factors=(study.factors[0], lights), count=500)

    dim = sum(setting_of(study, index)["light"] == "dim" for index in range(study.shots))

    assert abs(dim - 900) < 4 * np.sqrt(1000 * 0.9 * 0.1)


def test_a_study_without_bounds_has_the_same_estimates(study, rows):
    without = replace(study, bounds=False)

    row, bounded = study_rows(without, 5)[0], next(row for row in rows if row["shot"] == 5)

    assert bounded["bound_center_m"] is not None
    assert [name for name in row if name.startswith("bound_") and row[name] is not None] == []
    assert row["determined"] == ""
    same = [name for name in row if not name.startswith("bound_") and name not in {*TIMES, "determined"}]
    assert {name: row[name] for name in same} == {name: bounded[name] for name in same}


def test_errors_of_the_default_method_are_near_their_bound(study, rows):
    statistics = summarized(study, rows).all("ml")

    assert statistics.answers == statistics.targets == study.shots
    # of ratios that are 1, 96 % are in this band if 8 shots count along one direction, and 99.95 % if along all three
    assert 0.5 < statistics.rms("ratio_center_m") < 1.5
    assert 0.5 < statistics.rms("ratio_normal_rad") < 1.5
    assert 0.4 < statistics.mean("center_nees") < 2.0
    assert statistics.wrong == 0


def test_a_known_radius_lowers_bound_and_error(study, rows):
    summary = summarized(study, rows)

    assert summary.all("ml-known").rms("bound_center_m") < 0.5 * summary.all("ml").rms("bound_center_m")
    assert summary.all("ml-known").rms("center_m") < 0.5 * summary.all("ml").rms("center_m")


def test_the_first_table_has_the_form_of_the_papers(study, rows):
    lines = study_text(study, summarized(study, rows)).splitlines()

    assert lines[3].split()[-4:] == ["300", "mm", "500", "mm"]
    assert [line.split("(")[0].split()[-1] for line in lines[4:9]] == ["x", "y", "z", "pitch", "yaw"]


def test_a_shot_that_cannot_be_computed_is_a_row_with_the_reason(study):
    exact = replace(study.scene, rig=replace(study.scene.rig, stability=RigStability()))
    impossible = replace(study, scene=exact, factors=(*study.factors, Factor(name="rig_errors", values=(True,))))

    failed = study_rows(impossible, 0)

    assert [row["method"] for row in failed] == ["ml", "ml-known", "paper"]
    assert all(row["outcome"] == "error" and "covariance" in row["reason"] for row in failed)
    assert summarized(impossible, failed).all("ml").failed == 1


def test_limits_are_checked_in_every_cell(study, rows):
    limited = replace(study, limits={"max_center_m": 1e-9, "min_available_share": 0.5})

    exceeded = exceeded_limits(limited, summarized(limited, rows))

    cells = [message for message in exceeded if "max_center_m" in message]
    assert len(cells) == len(exceeded) == study.cells
    assert sum("300 mm" in message and "dim" in message for message in cells) == 1
    assert exceeded_limits(replace(study, limits={"max_center_m": 1.0}), summarized(study, rows)) == []


def test_limits_on_wrong_shots_with_the_status_ok_are_stated_by_case(study):
    cases = {"none": (), "turned": (Factor(name="plane_tilt_rad", values=(0.002,)),)}
    by_case = replace(
        study,
        factors=(Factor(name="case", values=tuple(cases)), *study.factors[:2]),
        cases=cases,
        limits={"max_ok_wrong_share": {"none": 0.0, "turned": 0.4}},
    )
    row = dict.fromkeys(columns(by_case)) | {"method": "ml", "expect": "pose", "distance_m": 0.3, "light": "dim"}
    wrong = {"outcome": "pose", "status": "ok", "wrong": "normal"}
    right = {"outcome": "pose", "status": "ok", "correct": "normal"}
    flagged = wrong | {"status": "degraded"}
    rows = [row | {"case": "turned"} | each for each in (wrong, right, flagged)]

    kept = exceeded_limits(by_case, summarized(by_case, [*rows, row | {"case": "none"} | right]))
    missed = exceeded_limits(by_case, summarized(by_case, [row | {"case": "none"} | wrong, *rows, *rows[:1]]))

    assert kept == []
    assert len(missed) == 2
    assert "none" in missed[0]
    assert "turned" in missed[1]


def test_the_violated_assumptions_have_a_limit_each():
    study = read_study(study_path("violations"))

    assert set(study.limits["max_ok_wrong_share"]) == set(study.cases)


@pytest.fixture(scope="module")
def dirt():
    return read_study(study_path("dirt"), count=1)


@pytest.mark.slow
def test_surfaces_change_the_images_of_a_shot_and_not_its_truth(dirt):
    clean, ghost = (study_shot(dirt, index, setting_of(dirt, index)) for index in range(2))

    change_dn = np.subtract(ghost.run[-1].images[1], clean.run[-1].images[1], dtype=np.float64).mean(axis=1)
    row, seen = int(np.argmax(clean.run[-1].images[1].mean(axis=1))), dirt.surfaces["ghost"].ghost
    assert (list(dirt.cases)[:2], ghost.scene.lasers.ghost) == (["none", "ghost"], None)
    assert abs(int(np.argmax(change_dn)) - row - seen.rows_px) <= 1.0
    np.testing.assert_array_equal(ghost.truth.center_m, clean.truth.center_m)


def test_shots_are_counted_by_case_and_status(dirt):
    row = dict.fromkeys(columns(dirt)) | {"method": "ml", "expect": "pose", "case": "gap"}
    rows = [row | {"status": status, "wrong": wrong} for status, wrong in (("ok", "center normal"), ("none", ""))]

    (line,) = (cells for cells in status_table(dirt, summarized(dirt, rows)).rows if cells[0] == "gap")

    assert line == ["gap", "ml", "1", "0", "1", "2", "1"]


def test_a_surface_that_the_study_does_not_describe_is_refused(tmp_path):
    text = study_path("dirt").read_text().replace("surfaces: heads+gap", "surfaces: heads+gab")
    (tmp_path / "study.yaml").write_text(text.replace("scene: ", f"scene: {study_path('dirt').parent}/"))

    with pytest.raises(DataError, match=r"cases\.heads\+gap\.surfaces: names 'gab'.*did you mean 'gap'"):
        read_study(tmp_path / "study.yaml")


def test_the_worst_shots_are_those_with_the_largest_errors(study, rows):
    worst = worst_shots(rows, "ml", 3)

    errors = {row["shot"]: row["center_m"] for row in rows if row["method"] == "ml"}
    assert worst == sorted(errors, key=errors.get, reverse=True)[:3]


def test_a_shot_with_a_pose_is_never_reported_as_one_without(study):
    blank = dict.fromkeys(columns(study)) | {"method": "ml", "expect": "partial"}
    rows = [
        blank | {"shot": 0, "status": "degraded", "reason": "the edges may be straight", "center_m": 0.02},
        blank | {"shot": 1, "status": "degraded", "reason": "the edges may be straight", "grasp_m": 0.0012},
        blank | {"shot": 2, "status": "degraded", "normal_rad": 0.1},
        blank | {"shot": 3, "status": "none", "reason": "no stripe"},
    ]

    assert [finding(row) for row in rows] == [
        "centre error 20 mm",
        "grasp point error 1.2 mm",
        "a pose without centre and grasp point",
        "no pose: no stripe",
    ]
    assert worst_shots(rows, "ml", 4) == [3, 0, 1, 2]


@pytest.mark.parametrize(
    ("name", "value", "found"),
    [
        ("ring_radius_outer_m", 0.8, lambda scene: scene.ring.radius_outer_m),
        ("baseline_m", 0.2, lambda scene: np.hypot(*scene.rig.lasers.projector_m[:, :2].T).mean()),
        ("blur_px", 1.5, lambda scene: scene.lens.blur_px),
        ("dark_noise_e", 20.0, lambda scene: scene.sensor.temporal_dark_noise_e),
        ("speckle_contrast", 0.1, lambda scene: scene.speckle.contrast),
        ("stripe_dn", 100.0, lambda scene: scene.stripe_dn),
    ],
)
def test_a_factor_changes_what_it_names(study, name, value, found):
    scene = scene_of(study, 0, {"distance_m": 0.5, name: value})

    assert found(scene) == pytest.approx(value)


def test_a_whole_ring_has_its_centre_in_the_middle_of_the_image(study):
    scene = scene_of(study, 0, {"distance_m": 0.8, "whole": True, "offset": 0.0})
    camera, (view,) = scene.rig.camera, scene.views

    middle_px = project(view.center_m, camera)

    np.testing.assert_allclose(middle_px, [(camera.image_width - 1) / 2, (camera.image_height - 1) / 2], atol=1e-6)
    assert view.center_m[2] == pytest.approx(0.8)


@pytest.mark.parametrize("name", ["sizes", pytest.param("sizes-rendered", marks=pytest.mark.slow)])
def test_the_radius_of_a_ring_and_its_error_are_columns_of_their_own(name):
    study = replace(read_study(study_path(name)), level="features", methods=(StudyMethod.ML,))

    for index in range(0, study.cells, max(study.cells // 12, 1)):
        (row,) = study_rows(study, index)

        assert row["outcome"] != ERROR, row["reason"]
        assert row["ring_radius_outer_m"] == setting_of(study, index)["ring_radius_outer_m"]
        assert row["radius_outer_m"] is None or abs(row["radius_outer_m"]) < 1.0


def test_the_laser_angle_turns_the_outer_planes_about_their_projectors(study):
    lasers = scene_of(study, 0, {"distance_m": 0.5, "laser_angle_rad": 0.1}).rig.lasers

    assert np.arctan2(lasers.normal[:, 2], lasers.normal[:, 1]) == pytest.approx([-0.1, 0.0, 0.1])
    assert (lasers.normal * lasers.projector_m).sum(axis=1) == pytest.approx(lasers.distance_m)


def test_a_case_replaces_single_factors(study):
    cases = {"none": (), "turned": (Factor(name="plane_tilt_rad", uniform=(0.01, 0.02), drawn=True),)}
    factors = (Factor(name="case", values=tuple(cases)), *study.factors, Factor(name="plane_tilt_rad", values=(0.0,)))
    settings = [setting_of(replace(study, factors=factors, cases=cases), index) for index in range(8)]

    assert [each["case"] for each in settings] == ["none"] * 4 + ["turned"] * 4
    assert [each["plane_tilt_rad"] for each in settings[:4]] == [0.0] * 4
    assert all(0.01 < each["plane_tilt_rad"] < 0.02 for each in settings[4:])
    assert [each["tilt_rad"] for each in settings[:4]] == [each["tilt_rad"] for each in settings[4:]]


def test_a_slightly_turned_plane_leaves_the_others_where_they_are(study):
    """Although the projectors of a calibrated rig are not exactly in their planes."""
    rig = study.scene.rig
    lasers = replace(rig.lasers, projector_m=rig.lasers.projector_m + np.array([0.0, 0.002, 0.0]))
    study = replace(study, scene=replace(study.scene, rig=replace(rig, lasers=lasers)))
    setting = {"distance_m": 0.5, "light": "normal"}

    exact, turned = (study_shot(study, 0, {**setting, "plane_tilt_rad": each}).truth for each in (0.0, 1e-9))

    np.testing.assert_allclose(turned.break_points_px, exact.break_points_px, atol=1e-4)


@pytest.mark.slow
def test_a_turned_plane_contradicts_the_rig_that_measures(study):
    status = {}
    for tilt_rad in (0.0, 0.01):
        factors = (*study.factors[:2], Factor(name="plane_tilt_rad", values=(tilt_rad,)))
        turned = replace(study, factors=factors, methods=(StudyMethod.ML,))
        status[tilt_rad] = [row["status"] for index in range(4) for row in study_rows(turned, index)]

    assert status[0.0] == ["ok"] * 4
    assert "ok" not in status[0.01]


def test_the_estimator_assumes_what_the_study_states(study):
    drawn, stated = (
        study_rows(replace(study, methods=(StudyMethod.ML,), assumed=assumed), 0)[0]
        for assumed in (None, AssumptionOptions(still=True, ring_tolerance_m=0.002))
    )

    assert stated["sigma_normal_rad"] > 2 * drawn["sigma_normal_rad"]


@pytest.mark.slow
@pytest.mark.parametrize(("case", "flag"), [("not round or flat", "ring_form"), ("too fast", "motion")])
def test_a_rendered_shot_that_violates_an_assumption_is_flagged(case, flag):
    study = read_study(study_path("violations"))
    rows = [study_rows(study, turn * study.cells + list(study.cases).index(case))[0] for turn in range(3)]

    assert any(flag in str(row["flags"]).split() for row in rows)
    assert all(str(row["wrong"] or "velocity") == "velocity" for row in rows)


@pytest.mark.slow
def test_an_image_of_a_study_is_detected_and_scored(study):
    images = replace(study, level="images", factors=(Factor(name="distance_m", values=(0.5,)),))

    first, second = (study_rows(images, 0) for _ in range(2))

    assert [without_times(row) for row in first] == [without_times(row) for row in second]
    assert first[0]["status"] == "ok"
    assert first[0]["detect_s"] > 0


@pytest.mark.slow
@pytest.mark.parametrize("index", [412, 966, 710, 1084])
def test_visible_edges_that_contradict_the_stripes_leave_no_wrong_quantity_without_a_flag(index):
    """A stripe on a surface behind the ring beside a missing or a wrong one: two stripes that agree on another ring."""
    row = study_rows(read_study(study_path("outliers")), index)[0]

    assert row["method"] == "ml"
    assert row["edge_points"] > 30
    assert not row["wrong"]


# Runs of shots of a moving target


RUN, PRIOR = ShotRun(shots=3, period_s=0.25), MotionPrior(speed_sd_m_s=0.02, rate_sd_rad_s=0.03)


@pytest.fixture(scope="module")
def moving(study):
    return replace(
        study,
        count=1,
        factors=(
            Factor(name="distance_m", values=(0.5,)),
            Factor(name="speed_sd_m_s", values=(0.0, 0.01)),
            Factor(name="rate_sd_rad_s", values=(0.0, 0.01)),
        ),
        methods=(StudyMethod.ML, StudyMethod.TRACK),
        run=RUN,
    )


def test_each_laser_of_a_moving_target_shows_it_where_it_is_at_its_frame(moving, rng):
    single = replace(moving, run=ShotRun())
    scene = with_run(scene_of(single, 0, {"distance_m": 0.5}), RUN, PRIOR, rng)

    drawn = list(drawn_features(scene, Deviations(noise=False)))

    assert len(drawn) == RUN.shots
    for number in (0, RUN.shots - 1):
        view, shot = scene.views[number], drawn[number]
        points = shot.detection.break_points
        for laser, stamp_s in enumerate(points.stamp_s):
            passed_s = stamp_s - scene.start_s - number * RUN.period_s
            rotation, translation_m = view.path.camera_from_target(view.begin_s + passed_s)
            center_m = rotation @ [0.0, 0.0, scene.ring.height_m] + translation_m
            still = replace(view, path=None, center_m=center_m, normal=rotation[:, 2])
            seen = next(drawn_features(replace(scene, views=(still,)), Deviations(noise=False)))
            assert points.position_px[laser] == pytest.approx(seen.detection.break_points.position_px[laser], abs=1e-3)


def test_the_last_shot_of_a_run_is_in_the_pose_of_the_factors(moving):
    setting = {"distance_m": 0.5, "speed_sd_m_s": 0.01, "rate_sd_rad_s": 0.01}
    single = scene_of(replace(moving, run=ShotRun()), 0, setting).views[-1]

    first, *_, last = scene_of(moving, 0, setting).views

    assert last.center_m == pytest.approx(single.center_m)
    assert last.normal == pytest.approx(single.normal)
    assert 0.001 < np.linalg.norm(first.center_m - last.center_m) < 0.1


def test_a_track_of_three_shots_is_better_than_the_last_one(moving):
    rows = [row for index in range(moving.shots) for row in study_rows(moving, index)]

    by_method = {method: [row for row in rows if row["method"] == method] for method in ("ml", "track")}
    rms = {method: np.sqrt(np.mean([row["normal_rad"] ** 2 for row in found])) for method, found in by_method.items()}
    assert rms["track"] < 0.8 * rms["ml"]
    assert all(row["wrong"] == "" and row["status"] != "none" for row in by_method["track"])
    assert all((row["velocity_m_s"] is None) == (index % 4 == 0) for index, row in enumerate(by_method["ml"]))


def test_availability_is_the_share_of_the_shots_whose_features_determine_a_quantity(study, rows):
    statistics = summarized(study, rows).all("ml")

    assert statistics.determined["grasp"] == study.shots
    assert statistics.determined["center"] == sum("center" in str(row["determined"]) for row in rows[::3]) > 0
    assert statistics.reported == statistics.determined
    assert sum(statistics.stripes.values()) == study.shots


def test_a_center_is_determined_only_within_the_limit_of_its_flag(study):
    dark = {"distance_m": 0.3, "light": "dim", "tilt_rad": 0.0}
    scenes = [scene_of(study, 0, {**dark, "ring_radius_outer_m": radius_m}) for radius_m in (0.3, 3.0)]

    small, large = (shown_by(scene, [False]) for scene in scenes)

    assert small.stripes == large.stripes == 3
    assert (small.determined[False], large.determined[False]) == (("center", "grasp"), ("grasp",))


@pytest.mark.parametrize(
    ("radius_m", "light", "stripes", "without_radii", "with_radii"),
    [
        (0.055, "dim", 1, False, True),  # both arcs: without radii these may be two bars
        (0.08, "dim", 1, False, False),  # one arc: two ends may be those of any surface
        (0.08, "normal", 1, True, True),
        (0.11, "dim", 2, False, True),
        (0.3, "dim", 3, True, True),
    ],
)
def test_a_grasp_point_is_determined_where_the_shot_shows_a_ring(radius_m, light, stripes, without_radii, with_radii):
    sizes = read_study(study_path("sizes"))
    setting = {"distance_m": 0.3, "light": light, "ring_radius_outer_m": radius_m, "tilt_rad": 0.1}

    shown = shown_by(scene_of(sizes, 0, setting), [False, True])

    assert shown.stripes == stripes
    assert [("grasp" in shown.determined[known]) for known in (False, True)] == [without_radii, with_radii]


@pytest.mark.parametrize(("seed", "index"), [(21, 6), (26, 54)])
def test_two_tilts_about_one_stripe_whose_ellipses_fit_leave_the_pose_open(seed, index):
    """A small ring that one stripe crosses: its lit edges are the image of two circles through that stripe."""
    sizes = replace(read_study(study_path("sizes"), 4, seed), methods=(StudyMethod.ML,))

    (row,) = study_rows(sizes, index)

    assert row["wrong"] == ""
    assert row["status"] != "ok" or row["center_nees"] < 10.0
