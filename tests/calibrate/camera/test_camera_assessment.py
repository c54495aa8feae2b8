"""Assessment of a camera calibration, on views of a known camera."""

import re
from dataclasses import replace
from functools import partial
from pathlib import Path

import cv2
import numpy as np
import pytest
from known_views import CHESSBOARD, TRUE_CAMERA, board_view, chessboard_views, true_poses
from ring_scenes import make_camera

from ringpose.calibrate.camera.assessment import camera_assessment
from ringpose.calibrate.camera.bundle_adjustment import camera_solution, corners_of
from ringpose.calibrate.camera.parameters import PLUMB_BOB, CameraModel
from ringpose.calibrate.camera.pipeline import assessed_camera, calibrate_camera
from ringpose.calibrate.camera.quality import camera_quality, camera_summary, camera_verdict, projection_sigma_m
from ringpose.calibrate.camera.validation import (
    cameras_one_step_away,
    cameras_without_one,
    displacement_px,
    held_out_rms_px,
    model_comparison,
    projection_sigma_px,
    radial_stretch_sd,
)
from ringpose.geometry.board import corner_points
from ringpose.geometry.rays import fold_px
from ringpose.types.board import BoardView, BoardViews
from ringpose.types.calibration import Grade, Verdict

POINTS = corner_points(CHESSBOARD)
NOISE_PX = 0.05


@pytest.fixture
def views(rng):
    """Makes views with noise of 0.05 px."""
    return partial(chessboard_views, rng)


@pytest.fixture(scope="module")
def assessed():
    """The assessment of a camera calibrated with ten views."""
    boards = chessboard_views(np.random.default_rng(10), 10)
    return camera_assessment(calibrate_camera(boards, 1600, 1200), PLUMB_BOB, (0.5, 1.0))


def frontal_views(rng, number: int) -> list[BoardView]:
    """Views of boards at one distance with small tilts, none in the left of the image."""
    found = []
    for index in range(number):
        lean = np.asarray(cv2.Rodrigues(np.radians(rng.uniform(-8, 8, 3)))[0])
        place = np.array([rng.uniform(-0.05, 0.0), rng.uniform(-0.13, -0.11), 0.5])
        found.append(board_view(POINTS, (lean, place), f"v{index}", NOISE_PX * rng.standard_normal((len(POINTS), 2))))
    return found


def verdict_of(found, boards, images: int | None = None) -> Verdict:
    return camera_verdict(camera_assessment(found, PLUMB_BOB), images or len(boards))


def value(verdict: Verdict, name: str) -> float:
    return next(finding.value for finding in verdict.findings if finding.name == name)


@pytest.mark.slow
def test_the_projection_errs_by_the_uncertainty_that_is_reported(views):
    squares = []
    for _ in range(25):
        boards = views(8)
        found = calibrate_camera(boards, 1600, 1200)
        error_px = displacement_px(found.camera, TRUE_CAMERA)
        squares.append(np.mean(error_px**2 / projection_sigma_px(found.camera, found.camera.covariance.data) ** 2))

    assert np.mean(squares) == pytest.approx(1.0, abs=1.96 * np.std(squares) / np.sqrt(25))


@pytest.mark.slow
def test_views_of_noise_alone_hardly_ever_widen_the_covariance(views):
    wider = 0
    for _ in range(16):
        boards = views(8)
        found = calibrate_camera(boards, 1600, 1200)
        assessed = camera_assessment(found, PLUMB_BOB).calibration
        wider += assessed.standard_deviations["fx"] > 1.01 * found.standard_deviations["fx"]

    assert wider <= 2


def test_held_out_views_count_by_their_corners(views):
    boards = views(4)
    few = np.arange(0, 98, 7)
    noisy = replace(
        boards[0],
        ids=boards[0].ids[few],
        points_px=boards[0].points_px[few] + np.tile([[3.0, -3.0], [-3.0, 3.0]], (7, 1)),
        points_board_m=boards[0].points_board_m[few],
    )
    used = [noisy, *boards[1:]]
    whole = camera_solution(used, TRUE_CAMERA, PLUMB_BOB)

    fit, _ = model_comparison(used, whole, PLUMB_BOB).fits

    others = cameras_without_one(used, whole, PLUMB_BOB)
    held_out_px = [held_out_rms_px(view, each) for view, each in zip(used, others, strict=True)]
    counts = [len(view.ids) for view in used]
    assert held_out_px[0] > 3.0 * max(held_out_px[1:])
    assert fit.held_out_rms_px == pytest.approx(np.sqrt(np.dot(counts, np.square(held_out_px)) / sum(counts)))


def test_views_of_a_bent_board_widen_the_covariance(views):
    boards = [
        replace(view, points_px=view.points_px + 3 * np.sin(index) * (view.points_board_m[:, :2] / 0.3) ** 2)
        for index, view in enumerate(views(8))
    ]
    found = calibrate_camera(boards, 1600, 1200)

    assessed = camera_assessment(found, PLUMB_BOB)

    ratio = assessed.calibration.standard_deviations["fx"] / found.standard_deviations["fx"]
    assert ratio > assessed.disagreement > 2  # it contains the difference of two halves of the views, too


def test_good_views_are_good(views):
    boards = views(12)

    verdict = verdict_of(calibrate_camera(boards, 1600, 1200), boards)

    assert verdict.grade is Grade.GOOD
    assert verdict.advice == ()


def test_frontal_views_of_one_distance_are_not_good_and_the_advice_names_the_reasons(rng):
    boards = frontal_views(rng, 8)

    verdict = verdict_of(calibrate_camera(boards, 1600, 1200), boards)

    advice = " | ".join(verdict.advice)
    assert verdict.grade is not Grade.GOOD
    assert "degrees of frontal" in advice
    assert "one distance only (0.5" in advice
    assert "hardly any corners in the upper left," in advice


def test_ten_images_of_a_board_at_rest_count_as_one_view(rng):
    (pose,) = true_poses(rng, 1)
    noise = [NOISE_PX * rng.standard_normal((len(POINTS), 2)) for _ in range(10)]
    boards = [board_view(POINTS, pose, f"v{index}", error) for index, error in enumerate(noise)]

    verdict = verdict_of(calibrate_camera(boards, 1600, 1200), boards)

    assert value(verdict, "views_used") == 1.0
    assert verdict.grade is Grade.REDO
    assert any("only 1 of the 10 views differ" in advice for advice in verdict.advice)


def test_images_without_a_board_lower_the_verdict(assessed):
    verdict = camera_verdict(assessed, 25)

    assert value(verdict, "images_used_share") == pytest.approx(0.4)
    assert verdict.grade is Grade.REDO


def test_a_view_on_which_the_result_depends_is_named(assessed):
    left_out = tuple(replace(view, shift_px=4.0) if view.name == "v2" else view for view in assessed.left_out)

    verdict = camera_verdict(replace(assessed, left_out=left_out), 10)

    assert any("the result depends mainly on v2" in sentence for sentence in verdict.advice)


def test_three_views_can_be_assessed_but_not_left_out(views):
    boards = views(3)
    found = calibrate_camera(boards, 1600, 1200)

    assessed = camera_assessment(found, PLUMB_BOB, compare=True)

    assert assessed.left_out == ()
    assert np.isnan(assessed.disagreement)
    verdict = camera_verdict(assessed, 3)
    assert verdict.grade is Grade.REDO
    assert not any("disagree" in sentence or "depends mainly" in sentence for sentence in verdict.advice)
    assert not any("nan" in line or "left out fit" in line for line in camera_summary(assessed, verdict))


@pytest.mark.slow
def test_held_out_views_are_not_fitted_better_by_coefficients_that_the_lens_does_not_have(views):
    boards = views(10)
    found = calibrate_camera(boards, 1600, 1200)

    comparison = camera_assessment(found, PLUMB_BOB, compare=True).comparison

    plumb_bob, rational = comparison.fits
    assert rational.rms_px < plumb_bob.rms_px
    assert rational.held_out_rms_px > 0.99 * plumb_bob.held_out_rms_px
    assert np.nanmax(comparison.difference_px) < 0.1


def test_millimetres_grow_with_distance(assessed):
    near, far = projection_sigma_m(assessed)
    assert far == pytest.approx(2 * near)
    assert near == pytest.approx(np.median(assessed.sigma_px) / 1781 * 0.5, rel=1e-3)


def test_corners_left_out_are_numbered_with_their_residuals(views):
    boards = views(8)
    moved = boards[3].points_px.copy()
    moved[17] += [0.0, 0.7]
    boards[3] = replace(boards[3], points_px=moved)
    found = calibrate_camera(boards, 1600, 1200)
    assessed = camera_assessment(found, PLUMB_BOB)
    verdict = camera_verdict(assessed, 8)

    view = camera_quality(assessed, verdict)["quality"]["views"][3]
    (corner,) = view["corners_left_out"]

    assert corner["corner"] == 17
    assert corner["residual_px"][1] == pytest.approx(0.7, abs=0.2)
    assert camera_summary(assessed, verdict)[0].startswith("v3: corners left out: 17: more than 5 sigmas off")


def test_a_corner_that_is_misprinted_is_one_line_with_its_displacement(rng):
    misprinted = POINTS.copy()
    misprinted[17] += [0.0, 0.0006, 0.0]
    boards = [
        replace(board_view(misprinted, pose, f"v{index}", noise_px), points_board_m=POINTS)
        for index, pose in enumerate(true_poses(rng, 8))
        for noise_px in [NOISE_PX * rng.standard_normal(POINTS[:, :2].shape)]
    ]
    assessed = camera_assessment(calibrate_camera(boards, 1600, 1200), PLUMB_BOB)

    lines = [
        line for line in camera_summary(assessed, camera_verdict(assessed, 8)) if "corner" in line and " 17" in line
    ]

    (line,) = lines
    assert re.fullmatch(r"corner 17 is off in 8 of 8 views, by 0\.(5\d|60) mm: see the print there", line)


def test_the_manual_lists_every_limit(views):
    boards = [replace(view, marker_size_ratio=(1.0, 1.0)) for view in views(5)]
    found = calibrate_camera(boards, 1600, 1200)
    verdict = camera_verdict(camera_assessment(found, PLUMB_BOB), 5)
    page = (Path(__file__).parents[3] / "man" / "ringpose-calibrate-camera.1").read_text()

    listed = re.findall(r"^\.It (\w+) Ta (\S+) Ta (\S+)$", page, re.MULTILINE)

    limits = [(finding.name, finding.pass_limit, finding.fail_limit) for finding in verdict.findings]
    assert [name for name, _, _ in listed] == [name for name, _, _ in limits]
    assert [float(good) for _, good, _ in listed] == pytest.approx([good for _, good, _ in limits], rel=0.03)
    assert [redo if redo == "none" else float(redo) for _, _, redo in listed] == [
        "none" if np.isinf(redo) else pytest.approx(redo, rel=0.03) for _, _, redo in limits
    ]


def test_one_step_leaves_out_a_view_nearly_as_solving_anew_does(views):
    boards = views(10)
    found = calibrate_camera(boards, 1600, 1200).camera

    whole = camera_solution(boards, found, PLUMB_BOB)
    stepped = cameras_one_step_away(whole, PLUMB_BOB)
    solved = cameras_without_one(boards, whole, PLUMB_BOB)

    apart_px = [np.median(displacement_px(*pair)) for pair in zip(stepped, solved, strict=True)]
    moved_px = [np.median(displacement_px(found, camera)) for camera in solved]
    assert np.mean(apart_px) < 0.1 * np.mean(moved_px)


@pytest.mark.slow
def test_many_views_of_noise_alone_agree(views):
    boards = views(25)

    verdict = verdict_of(calibrate_camera(boards, 1600, 1200), boards)

    assert 0.5 < value(verdict, "view_disagreement") < 1.7


@pytest.mark.slow
def test_a_lens_that_plumb_bob_does_not_describe_asks_for_the_other_model(rng):
    boards = []
    for index, (turn, place) in enumerate(true_poses(rng, 14)):
        points = POINTS @ turn.T + place
        flat = points[:, :2] / points[:, 2:]
        pixels = 1000 * flat / (1 + 4 * np.sum(flat**2, axis=1, keepdims=True)) + [400.0, 300.0]
        noisy = pixels + 0.01 * rng.standard_normal(pixels.shape)
        boards.append(BoardView(name=f"v{index}", ids=np.arange(len(POINTS)), points_board_m=POINTS, points_px=noisy))
    found = calibrate_camera(boards, 800, 600)

    verdict = camera_verdict(camera_assessment(found, PLUMB_BOB, compare=True), 14)

    assert value(verdict, "held_out_ratio") > 1.05
    assert any("use --distortion-model rational_polynomial" in sentence for sentence in verdict.advice)


def within(radius_px: float, boards: list[BoardView]) -> BoardViews:
    """The corners within this distance from the middle of the image."""
    near = [np.linalg.norm(view.points_px - [800.0, 600.0], axis=1) < radius_px for view in boards]
    middle = [corners_of(view, mask) for view, mask in zip(boards, near, strict=True)]
    return BoardViews(views=middle, image_width=1600, image_height=1200)


def test_a_k3_that_the_views_do_not_determine_is_held_at_zero_and_reported(views):
    boards = within(250.0, views(12))
    free = calibrate_camera(boards.views, 1600, 1200)

    found = assessed_camera(boards)

    advice = camera_verdict(found, 12).advice
    sd = free.standard_deviations["k3"]
    assert found.calibration.standard_deviations["k3"] == 0
    assert found.known_sigma_px.max() < projection_sigma_px(free.camera, free.covariance.data).max() / 10
    assert f"k3 is held at 0, because the views determine it to +- {sd:.2g} only" in " ".join(advice)


def test_a_k3_that_the_views_determine_is_estimated(views):
    found = assessed_camera(within(1000.0, views(8)))

    assert found.calibration.standard_deviations["k3"] > 0
    assert "held" not in " ".join(camera_verdict(found, 8).advice)


def lens_views(rng, distortion: tuple[float, ...], noise_px: float, radius_px: float) -> BoardViews:
    """Corners near the middle of the images of a wide lens, whose farthest corners see 45 degrees beside the axis."""
    camera = make_camera((1600, 1200), (1000.0, 1000.0), (803.7, 596.2), distortion)
    poses = true_poses(rng, 12)
    noises_px = noise_px * rng.standard_normal((len(poses), len(POINTS), 2))
    boards = [board_view(POINTS, pose, f"v{i}", noises_px[i], camera) for i, pose in enumerate(poses)]
    return within(radius_px, boards)


def test_a_k3_that_folds_the_image_is_held_at_zero_and_reported(rng):
    boards = lens_views(rng, (-0.3, 0.2, 0.0, 0.0, -0.4), 0.02, 550.0)
    at_px = fold_px(calibrate_camera(boards.views, 1600, 1200).camera)

    found = assessed_camera(boards)

    assert at_px is not None
    assert fold_px(found.calibration.camera) is None
    assert found.calibration.standard_deviations["k3"] == 0
    advice = " ".join(camera_verdict(found, 8).advice)
    assert f"the k3 of these views folds the image beyond pixel ({at_px[0]:.0f}, {at_px[1]:.0f})" in advice


def test_a_k3_is_estimated_however_uncertain_where_the_image_folds_without_it(rng):
    boards = lens_views(rng, (-0.5, 0.0, 0.0, 0.0, 0.3), 0.05, 400.0)
    without = calibrate_camera(boards.views, 1600, 1200, CameraModel(fix_k3=True))

    found = assessed_camera(boards)

    assert fold_px(without.camera) is not None
    assert fold_px(found.calibration.camera) is None
    assert radial_stretch_sd(found.calibration.camera) > 0.2
    assert "projection_sigma_worst_px" in [check.name for check in camera_verdict(found, 12).poor]
