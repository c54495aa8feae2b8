"""Accuracy of poses at 1 m after a calibration with boards at 0.41 to 0.55 m."""

import json
from dataclasses import replace
from itertools import product
from pathlib import Path

import cv2
import numpy as np
import pytest
from ring_scenes import moved_rig

from ringpose.cli.main import main
from ringpose.detect.pipeline import detect
from ringpose.files.boards import read_board
from ringpose.files.images.shots import read_shot, write_shot
from ringpose.files.rigs import read_rig
from ringpose.measure.stream import estimate_pose
from ringpose.simulate.pipeline import simulated_boards
from ringpose.types.scene import BoardSet, NamedBoardPose, Scene
from ringpose.types.target import Body, RingShape

DRAWS = 80


@pytest.fixture(scope="module")
def rmse_mm(shared_data):
    """Makes the RMSE of z at 1 m by a rig, of the rendered shots there as they are detected."""
    shots = shared_data / "rendered" / "rig_b"
    true = read_rig(shots / "rig.yaml")
    truths = [json.loads(line) for line in (shots / "truth.jsonl").read_text().splitlines()]
    far = {truth["shot"]: truth["center_m"][2] for truth in truths if truth["groups"]["distance_m"] == 1.0}
    seen = {name: detect(read_shot(shots / "shots" / f"{name}.npz"), true) for name in far}

    def found(rig) -> float:
        poses = {name: estimate_pose(one.break_points, rig, ring_edges=one.ring_edges) for name, one in seen.items()}
        return 1e3 * float(np.sqrt(np.mean([(poses[name].center_m[2] - z) ** 2 for name, z in far.items()])))

    return found


@pytest.fixture(scope="module")
def true_rig(shared_data):
    return read_rig(shared_data / "rendered" / "rig_b" / "rig.yaml")


@pytest.fixture(scope="module")
def rig_of_advised_boards(shared_data, rig_of_rendered_boards, true_rig, tmp_path_factory) -> Path:
    """The rendered boards and six simulated ones 1 m away, tilted, each laser's stripe across two of them."""
    boards, folder = shared_data / "rendered" / "calib_b", tmp_path_factory.mktemp("advised")
    board = read_board(boards / "plane_board.yaml")
    places = tuple(far_place(true_rig.lasers, *which) for which in product(range(3), (-0.26, 0.26)))
    views = BoardSet(board=board, poses=places, exposure_s=0.016, ambient_w_m2=1.5, sequence=(0, 1, 2, 4))
    ring = RingShape(profile_m=np.array([[0.567, 0.0], [0.567, 0.06], [0.597, 0.06], [0.597, 0.0]]))
    scene = Scene(rig=true_rig, ring=ring, body=Body(size_m=np.array([2.0, 2.0, 1.0])), lights={})
    for shot, place in simulated_boards(scene, views):
        write_shot(folder / f"{place.name}.npz", shot)
    camera, rig = rig_of_rendered_boards.with_name("camera.yaml"), folder / "rig.yaml"
    options = ["--board", str(boards / "plane_board.yaml"), "--camera", str(camera), "--output", str(rig)]
    main(["calibrate-planes", str(boards / "planes"), str(folder), *options])
    return rig


def far_place(lasers, laser, tilt_rad) -> NamedBoardPose:
    """A board 1 m away whose middle lies 30 mm below a laser's stripe."""
    height_m = (lasers.distance_m[laser] - lasers.normal[laser, 2]) / lasers.normal[laser, 1]
    turn = cv2.Rodrigues(np.array([tilt_rad, 0.2, 0.0]))[0]
    corner = np.array([0.0, height_m + 0.03, 1.0]) - turn @ [0.15, 0.12, 0.0]
    return NamedBoardPose(name=f"far_{laser}_{tilt_rad}", rotation=turn, translation_m=corner)


@pytest.fixture(scope="module")
def excess_mm(rmse_mm, true_rig):
    """Returns the RMSE of z at 1 m less that with the true rig: by a rig, and by rigs drawn from its covariance."""

    def of(rig_file) -> tuple[float, np.ndarray]:
        estimated, with_true = read_rig(rig_file), rmse_mm(true_rig)
        covariance = estimated.covariance
        true = replace(true_rig, covariance=covariance)
        rng = np.random.default_rng(1)
        wrong = rng.multivariate_normal(np.zeros(len(covariance.data)), covariance.data, DRAWS, method="eigh")
        drawn = np.array([rmse_mm(moved_rig(true, covariance.parameters, step)) for step in wrong])
        return rmse_mm(estimated) - with_true, drawn - with_true

    return of


@pytest.fixture(scope="module")
def near_excess_mm(excess_mm, rig_of_rendered_boards):
    return excess_mm(rig_of_rendered_boards)


@pytest.mark.slow
def test_poses_beyond_the_boards_have_the_uncertainty_that_the_rig_reports(near_excess_mm):
    estimated, drawn = near_excess_mm

    low, high = np.percentile(drawn, [2.5, 97.5])
    assert low < estimated < high


@pytest.mark.slow
def test_boards_at_half_a_metre_give_poses_at_one_metre_to_two_millimetres(near_excess_mm):
    """Speckle leaves 0.09 px in a stripe's centre: seen 0.41 to 0.55 m away and carried on to 1 m, millimetres."""
    _, drawn = near_excess_mm

    assert 0.8 < np.std(drawn) < 3.0
    assert np.mean(drawn > 0.5) > 0.2


@pytest.mark.slow
def test_six_boards_as_advised_give_poses_at_one_metre_to_a_millimetre(
    excess_mm, near_excess_mm, rig_of_advised_boards
):
    """The remaining error is caused by the camera."""
    estimated, drawn = excess_mm(rig_of_advised_boards)

    assert np.std(drawn) < min(1.0, 0.7 * np.std(near_excess_mm[1]))
    assert abs(estimated) < 1.0
