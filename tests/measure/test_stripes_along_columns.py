"""A rig whose stripes run along the image columns measures as well as the same rig with the camera turned."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from composed_ghosts import with_ghost
from turned_cameras import SWAP, TURN, transposed_rig, transposed_shot, turned_px, turned_rig, turned_shot

from ringpose.bench.design.bounds import cramer_rao
from ringpose.capture.latest_frame import EarlyStripes
from ringpose.console.engine import Engine
from ringpose.console.state import first_state
from ringpose.detect.difference_images import laser_images
from ringpose.detect.pipeline import Prior, detect
from ringpose.files import records
from ringpose.files.images.shots import read_shot
from ringpose.files.records.poses import pose_line_of, pose_record
from ringpose.files.rigs import read_rig
from ringpose.files.scenes.scene import read_scene
from ringpose.measure.stream import Setup, Stream, track_options
from ringpose.simulate.placement import ring_views
from ringpose.types.assumptions import USUAL
from ringpose.types.options import Method
from ringpose.types.pose import MEASURED_PARAMETERS
from ringpose.types.rig import LaserGhost

SHOTS = Path(__file__).parents[1] / "data" / "rig_b"
EXAMPLE = Path(__file__).parents[2] / "examples" / "scene.yaml"


@pytest.fixture(scope="module")
def rig():
    return read_rig(SHOTS / "rig.yaml")


@pytest.fixture(scope="module")
def shot():
    return read_shot(SHOTS / "shots" / "B_z0500_p01_normal.npz")


@pytest.fixture(scope="module")
def lines(rig, shot):
    """The line of the rig, and that of the same rig with the camera turned."""
    return Setup(rig=rig).measure(shot), Setup(rig=turned_rig(rig)).measure(turned_shot(shot))


@pytest.fixture(scope="module")
def drifting():
    """A rig, and shots of a target that drifts."""
    scene = read_scene(EXAMPLE)
    engine = Engine(scene, lambda *_: None)
    state = replace(first_state(scene, ring_views(scene)[0]), drift_m_s=np.array([0.01, 0.0, -0.01]), width=640)
    states = [replace(state, masks=(0, 1, 2, 4), time_s=0.2 * number, number=number) for number in range(4)]
    measured = [engine.measured(each) for each in states]
    return measured[0].rig, [each.shot for each in measured]


@pytest.fixture(scope="module")
def moving(drifting):
    """The same two lines of a moving target."""
    rig, (shot, *_) = drifting
    return Setup(rig=rig).measure(shot), Setup(rig=turned_rig(rig)).measure(turned_shot(shot))


def test_the_pose_is_the_turned_pose(lines):
    usual, turned = lines

    assert (turned.status, turned.flags, turned.lasers) == (usual.status, usual.flags, usual.lasers)
    for name in ("center_m", "normal", "grasp_m"):
        np.testing.assert_allclose(getattr(turned.pose, name), TURN @ getattr(usual.pose, name), atol=1e-8)
    for name in ("covariance_center_m2", "covariance_grasp_m2"):
        expected = TURN @ getattr(usual.pose, name) @ TURN.T
        np.testing.assert_allclose(getattr(turned.pose, name), expected, rtol=1e-5, atol=1e-14)


def test_a_faint_ghost_is_found_at_the_column_offset_that_the_rig_states(rig):
    shot = with_ghost(read_shot(SHOTS / "shots" / "B_z0500_p01_dim.npz"), 0.01, -15.0)
    ghost = LaserGhost(offset_px=15.0, offset_sd_px=0.02, ratio=0.01, ratio_sd=0.002)
    stating = replace(turned_rig(rig), ghosts=dict.fromkeys(rig.lasers.names, ghost))

    assert [each.offset_px for each in detect(turned_shot(shot), stating).ghosts] == [15.0]  # up becomes right
    assert detect(turned_shot(shot), turned_rig(rig)).ghosts == ()


def test_a_ghost_of_an_earlier_shot_is_found_again_though_it_is_faint(rig):
    shot = read_shot(SHOTS / "shots" / "B_z0500_p01_dim.npz")
    clear, faint = (turned_shot(with_ghost(shot, ratio, -15.0)) for ratio in (0.1, 0.01))

    earlier = detect(clear, turned_rig(rig)).ghosts
    found = detect(faint, turned_rig(rig), Prior(ghosts=earlier)).ghosts

    assert [each.offset_px for each in found] == [each.offset_px for each in earlier]
    assert earlier[0].offset_px == pytest.approx(15.0, abs=0.1)


def test_its_covariance_and_velocity_hold_in_the_tilt_basis_of_the_turned_normal(moving):
    usual, turned = moving

    np.testing.assert_allclose(turned.pose.covariance, usual.pose.covariance, rtol=1e-5, atol=1e-14)
    np.testing.assert_allclose(turned.velocity.center_m_s, TURN @ usual.velocity.center_m_s, atol=1e-8)
    np.testing.assert_allclose(turned.velocity.rate_rad_s, TURN @ usual.velocity.rate_rad_s, atol=1e-8)
    np.testing.assert_allclose(turned.velocity.covariance[3:, 3:], usual.velocity.covariance[3:, 3:], rtol=1e-5)


def test_its_information_is_that_of_the_turned_parameters(moving):
    usual, turned = (line.measurement for line in moving)
    change = np.eye(len(MEASURED_PARAMETERS))
    change[7:10, 7:10] = TURN

    def information(measured):
        return measured.square_root[:, :12].T @ measured.square_root[:, :12]

    expected = change @ information(usual) @ change.T
    scale = np.sqrt(np.diag(expected))
    np.testing.assert_allclose(
        information(turned) / np.outer(scale, scale), expected / np.outer(scale, scale), atol=1e-6
    )


def test_errors_of_the_camera_belong_to_the_axes_of_the_given_image(lines):
    usual, turned = (line.measurement for line in lines)
    columns = [
        dict(zip(each.nuisance_parameters, each.square_root[:, 12:-1].T, strict=True)) for each in (usual, turned)
    ]

    assert set(columns[0]) == set(columns[1])
    for name, column in columns[0].items():
        assert np.linalg.norm(columns[1][name]) == pytest.approx(np.linalg.norm(column), rel=1e-5)


def test_the_bound_of_the_turned_rig_is_as_large(lines):
    bounds = [cramer_rao(line) for line in lines]

    np.testing.assert_allclose(bounds[1].center_m2, TURN @ bounds[0].center_m2 @ TURN.T, rtol=1e-5, atol=1e-13)


def test_features_are_in_pixels_of_the_given_image(rig, shot):
    usual, turned = detect(shot, rig), detect(turned_shot(shot), turned_rig(rig))

    np.testing.assert_allclose(
        turned.break_points.position_px, turned_px(usual.break_points.position_px, rig), atol=1e-6
    )
    np.testing.assert_allclose(turned.stripes.position_px, turned_px(usual.stripes.position_px, rig), atol=1e-6)
    np.testing.assert_allclose(turned.ring_edges.position_px, turned_px(usual.ring_edges.position_px, rig), atol=1e-6)


@pytest.mark.parametrize("name", ["B_z0500_p01_normal", "B_z1000_p01_dim", "V03_occl_B500_dim"])
def test_transposed_images_give_the_mirrored_pose(rig, name):
    shot = read_shot(SHOTS / "shots" / f"{name}.npz")
    usual = Setup(rig=rig).measure(shot)

    transposed = Setup(rig=transposed_rig(rig)).measure(transposed_shot(shot))

    assert transposed.status == usual.status
    error = SWAP @ transposed.pose.center_m - usual.pose.center_m  # another order of pixels, another rounding of noise
    assert error @ np.linalg.solve(usual.pose.covariance_center_m2, error) < 0.25**2 * 3


@pytest.mark.parametrize("method", [Method.PAPER, Method.PAPER_CONSTRAINED])
def test_closed_forms_give_the_turned_pose(rig, shot, method):
    usual = Setup(rig=rig, method=method).measure(shot)

    turned = Setup(rig=turned_rig(rig), method=method).measure(turned_shot(shot))

    np.testing.assert_allclose(turned.pose.center_m, TURN @ usual.pose.center_m, atol=1e-8)


def test_lines_can_be_written_and_read(lines):
    line = lines[1]

    again = pose_line_of(records.plain(pose_record(line)), "the line")

    np.testing.assert_array_equal(again.measurement.square_root, line.measurement.square_root)


def test_a_stream_tracks_the_turned_target(drifting):
    rig, shots = drifting
    usual, turned = (
        Stream(Setup(rig=rig), track_options(USUAL)),
        Stream(Setup(rig=turned_rig(rig)), track_options(USUAL)),
    )

    tracks = [(usual.measure(shot).track, turned.measure(turned_shot(shot)).track) for shot in shots]

    assert [track.validity for _, track in tracks] == [track.validity for track, _ in tracks]
    for track, of_turned in tracks:
        np.testing.assert_allclose(of_turned.pose.center_m, TURN @ track.pose.center_m, atol=1e-6)


def test_stripes_that_were_found_early_are_those_of_the_whole_shot(drifting):
    rig, shots = turned_rig(drifting[0]), drifting[1]
    shot = turned_shot(shots[0])
    early = EarlyStripes(rig)
    for frame in shot.frames:
        early.add(frame, shot.saturation_dn)

    line = Stream(Setup(rig=rig), early=early.stripes_of).measure(shot).line

    assert None not in [early.stripes_of(image) for image in laser_images(shot, len(rig.lasers.names))]
    np.testing.assert_array_equal(line.pose.center_m, Stream(Setup(rig=rig)).measure(shot).line.pose.center_m)
