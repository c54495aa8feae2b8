"""Ghosts: a fainter copy of the laser light in rendered shots, moved by some rows (tests/data, ../shared/data)."""

import re
from dataclasses import replace

import numpy as np
import pytest
from composed_ghosts import moved, with_ghost

from ringpose.detect.pipeline import Prior, detect
from ringpose.files.images.shots import read_shot
from ringpose.files.rigs import read_rig
from ringpose.measure.stream import Setup, Stream
from ringpose.measure.warm_start import WarmStart
from ringpose.track.explanations import TrackOptions
from ringpose.track.pipeline import Tracker
from ringpose.types.detection import BreakPointFlag, SubtractedGhost
from ringpose.types.pose import PoseFlag
from ringpose.types.rig import LaserGhost

SHOTS = ("B_z0500_p01_dim", "B_z0500_p01_normal", "V03_occl_B500_dim")


def carried_shot(carried_data, name):
    folder = carried_data / "rig_b"
    return read_shot(folder / "shots" / f"{name}.npz"), read_rig(folder / "rig.yaml")


@pytest.mark.parametrize(("ratio", "rows"), [(0.1, -15.0), (0.35, -8.0), (0.2, 30.0)])
def test_the_ghost_of_a_frame_has_the_offset_and_the_ratio_that_it_was_made_with(carried_data, ratio, rows):
    shot, rig = carried_shot(carried_data, "B_z0500_p01_dim")
    ghosts = detect(with_ghost(shot, ratio, rows), rig).ghosts
    assert ghosts
    for ghost in ghosts:
        assert ghost.offset_px == pytest.approx(rows, abs=0.3)
        assert ghost.ratio == pytest.approx(ratio, rel=0.1)


@pytest.mark.parametrize("name", ["B_z0500_p01_dim", "V03_occl_B500_dim"])
def test_a_shot_with_a_ghost_has_the_pose_that_it_has_without(carried_data, name):
    shot, rig = carried_shot(carried_data, name)
    setup = Setup(rig=rig)
    without, line = setup.measure(shot), setup.measure(with_ghost(shot, 0.1, -15.0))
    assert (line.status, line.flags) == (without.status, without.flags | PoseFlag.GHOST_REMOVED)
    change_m = line.pose.grasp_m - without.pose.grasp_m
    assert change_m @ np.linalg.solve(without.pose.covariance_grasp_m2, change_m) < 1.0


def test_a_ghost_that_is_too_faint_to_be_found_is_subtracted_where_earlier_shots_had_it(carried_data):
    shot, rig = carried_shot(carried_data, "B_z0500_p01_dim")
    faint = with_ghost(shot, 0.01, -15.0)
    known = Prior(ghosts=(SubtractedGhost(offset_px=-15.0, ratio=0.1),))

    assert detect(faint, rig).ghosts == ()
    assert [ghost.ratio for ghost in detect(faint, rig, known).ghosts] == pytest.approx([0.01], rel=0.2)
    assert detect(shot, rig, known).ghosts == ()


def test_a_track_remembers_the_ghosts_of_its_camera(carried_data):
    shot, rig = carried_shot(carried_data, "B_z0500_p01_dim")
    start = WarmStart(Tracker(rig))

    seen = detect(with_ghost(shot, 0.1, -15.0), rig, start.before(shot, rig))
    start.after(shot, seen, start.before(shot, rig))

    assert start.before(shot, rig).ghosts == seen.ghosts != ()


def stating(rig, offset_px, ratio):
    """The rig with this ghost of each laser."""
    ghost = LaserGhost(offset_px=offset_px, offset_sd_px=0.02, ratio=ratio, ratio_sd=0.02 * ratio)
    return replace(rig, ghosts=dict.fromkeys(rig.lasers.names, ghost))


def test_a_stream_shows_the_ghost_of_its_stripes_and_removes_it_where_they_are_saturated(carried_data):
    shot, rig = carried_shot(carried_data, "B_z0500_p01_dim")
    stream = Stream(Setup(rig=rig), TrackOptions())
    shots = [*[with_ghost(shot, 0.1, -10.0)] * 3, with_ghost(shot, 0.1, -10.0, light=20.0)]

    *usual, full = (stream.measure(replace(each, stamp_s=each.stamp_s + number)) for number, each in enumerate(shots))

    (warning,) = [warning for measured in (*usual, full) for warning in measured.warnings]
    offset_px, ratio = map(float, re.search(r"a ghost at (\S+) ± \S+ px, (\S+) ±", warning).groups())
    assert offset_px == pytest.approx(-10.0, abs=0.1)
    assert ratio == pytest.approx(10.0, rel=0.05)
    assert detect(shots[-1], rig).ghosts == ()
    assert [ghost.ratio for ghost in full.detection.ghosts] == pytest.approx([0.1], rel=0.05)


def test_a_stream_does_not_warn_of_a_ghost_that_the_rig_states(carried_data):
    shot, rig = carried_shot(carried_data, "B_z0500_p01_dim")
    stream = Stream(Setup(rig=stating(rig, -10.0, 0.1)), TrackOptions())
    seen = with_ghost(shot, 0.1, -10.0)

    measured = [stream.measure(replace(seen, stamp_s=seen.stamp_s + number)) for number in range(4)]

    assert all(each.detection.ghosts for each in measured)
    assert not any(each.warnings for each in measured)


def stripes_beside(detection, clean):
    """How many stripe centres have none of the other detection within two rows in their column."""
    near = {(x, round(y) + rows) for x, y in clean.stripes.position_px for rows in range(-2, 3)}
    return sum((x, round(y)) not in near for x, y in detection.stripes.position_px)


def test_the_ghost_of_saturated_stripes_is_removed_where_the_rig_states_it(carried_data):
    shot, rig = carried_shot(carried_data, "B_z0500_p01_dim")
    full = with_ghost(shot, 0.1, -10.0, light=20.0)
    clean, unstated = detect(with_ghost(shot, 0.0, -10.0, light=20.0), rig), detect(full, rig)
    stated = detect(full, stating(rig, -10.0, 0.1))

    assert unstated.ghosts == ()
    assert [ghost.ratio for ghost in stated.ghosts] == pytest.approx([0.1], rel=0.05)
    assert stripes_beside(unstated, clean) > 3000
    assert stripes_beside(stated, clean) < 300


def test_a_ghost_that_the_rig_states_and_the_shot_does_not_show_is_not_removed(carried_data):
    shot, rig = carried_shot(carried_data, "B_z0500_p01_dim")
    assert detect(shot, stating(rig, -15.0, 0.1)).ghosts == ()


def test_an_end_that_the_ghost_of_saturated_light_may_hide_is_not_measured(carried_data):
    shot, rig = carried_shot(carried_data, "B_z0500_p00_dim")
    seen_px = detect(shot, rig).break_points.position_px[1]
    (left, _), (right, row) = seen_px[np.argsort(seen_px[:, 0])]
    cut, images = int(left + 0.6 * (right - left)), shot.images.copy()
    images[shot.lasers.tolist().index(2), int(row) + 12 : int(row) + 19, cut : int(right) + 60] = 255
    glint = replace(shot, images=images)

    ends = detect(with_ghost(glint, 0.1, -15.0), rig).break_points

    hidden = np.isnan(ends.position_px[1, :, 0])
    assert hidden.sum() == 1
    assert (ends.flags[1, hidden] & int(BreakPointFlag.UNCLEAR)).all()
    assert np.nanmin(ends.position_px[1, :, 0]) == pytest.approx(left, abs=1.0)


@pytest.mark.parametrize("name", SHOTS)
def test_a_shot_without_a_ghost_is_not_changed(carried_data, name):
    shot, rig = carried_shot(carried_data, name)
    assert detect(shot, rig).ghosts == ()


def test_stripes_of_equal_brightness_at_a_constant_distance_are_not_ghosts(carried_data):
    shot, rig = carried_shot(carried_data, "B_z0500_p01_dim")
    other = replace(shot, images=shot.images[:, :, ::-1])  # the same stripes with the speckle of other places
    dark = shot.images[0].astype(np.float64)
    frames = [
        np.clip(np.rint(image + 0.3 * moved(another - dark, -15.0)), 0, 255).astype(np.uint8) if mask else image
        for image, another, mask in zip(shot.images, other.images, shot.lasers.tolist(), strict=True)
    ]
    assert detect(replace(shot, images=np.stack(frames)), rig).ghosts == ()


@pytest.mark.slow
@pytest.mark.parametrize(("ratio", "rows"), [(0.1, -15.0), (0.2, 8.0)])
def test_rendered_shots_keep_their_poses_with_a_ghost_and_none_is_wrong(shared_data, ratio, rows):
    kept = total = 0
    for name in ("rig_a", "rig_b", "variants_a", "variants_b"):
        folder = shared_data / "rendered" / name
        setup = Setup(rig=read_rig(folder / "rig.yaml"))
        for path in sorted((folder / "shots").glob("*.npz")):
            shot = read_shot(path)
            without = setup.measure(shot).pose
            line = setup.measure(with_ghost(shot, ratio, rows))
            if without is None:
                continue
            total, kept = total + 1, kept + (line.pose is not None)
            if line.status == "ok":
                change_m = line.pose.grasp_m - without.grasp_m
                assert change_m @ np.linalg.solve(line.pose.covariance_grasp_m2, change_m) < 25.0
    assert total == 43
    assert kept >= 40
