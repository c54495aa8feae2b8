"""A rig checked by one new view, and mounted on a tool."""

import re

import numpy as np
import pytest
import yaml
from plane_views import ORDER, calibrate, calibrated


def test_a_rig_that_holds_is_confirmed_by_one_view(plane_folder, capsys):
    status = calibrated("--check", "camera.yaml", "planes/pln_B_01.npz")

    assert status == 0
    assert "left: " in (stderr := capsys.readouterr().err)
    assert " mm beside its plane (limit 0.0" in stderr


def test_a_rig_with_a_moved_plane_does_not_hold(plane_folder, capsys):
    rig = yaml.safe_load((plane_folder / "camera.yaml").read_text())
    rig["lasers"][1]["distance_m"] += 0.001
    (plane_folder / "camera.yaml").write_text(yaml.safe_dump(rig))

    status = calibrated("--check", "camera.yaml", "planes/pln_B_01.npz")

    assert status == 3
    beside = re.search(r"middle: ([-+.\d]+) mm beside its plane .*: does not hold", capsys.readouterr().err)
    assert abs(float(beside[1])) == pytest.approx(1.0, abs=0.02)


def test_a_rig_with_a_stripe_too_steep_for_rings_is_checked_too(plane_folder, capsys):
    rig = yaml.safe_load((plane_folder / "camera.yaml").read_text())
    rig["lasers"][0]["normal"] = [0.8, 0.6, 0.0]
    (plane_folder / "camera.yaml").write_text(yaml.safe_dump(rig))
    write_switched_shot()

    status = calibrated("--check", "camera.yaml", "switched.npz")

    assert status == 3
    assert re.search(r"left: .* mm beside its plane .*: does not hold", capsys.readouterr().err)


def test_swapped_lasers_are_named(plane_folder, capsys):
    rig = yaml.safe_load((plane_folder / "camera.yaml").read_text())
    (plane_folder / "camera.yaml").write_text(yaml.safe_dump(rig | {"lasers": rig["lasers"][::-1]}))
    write_switched_shot()

    status = calibrated("--check", "camera.yaml", "switched.npz")

    assert status == 3
    stderr = capsys.readouterr().err
    assert re.search(r"right: .* does not hold, it lies on the plane of left: are they swapped\?", stderr)
    assert re.search(r"left: .* does not hold, it lies on the plane of right: are they swapped\?", stderr)


def write_switched_shot() -> None:
    """Write switched.npz, whose first and last laser are on alone: strips of the picture with all of them."""
    with np.load("planes/pln_B_01.npz") as shot:
        dark, lit = shot["images"]
        rows = np.flatnonzero((lit.astype(int) - dark)[:, 760:840].mean(axis=1) > 20)
        above, below = rows[0] + 40, rows[-1] - 40
        first, last = dark.copy(), dark.copy()
        first[below:], last[:above] = lit[below:], lit[:above]
        frames = {"images": np.stack([dark, first, last]), "lasers": np.array([0, 1, 4], np.uint8)}
        times = {key: np.resize(shot[key], 3) for key in ("stamp_s", "exposure_s")}
    np.savez("switched.npz", **frames, **times)


def test_a_view_without_stripes_does_not_confirm_a_rig(plane_folder, capsys):
    with np.load("planes/pln_B_01.npz") as shot:
        np.savez("unlit.npz", **{**shot, "images": shot["images"][[0, 0]]})

    status = calibrated("--check", "camera.yaml", "unlit.npz")

    assert status == 3
    assert "no stripe on the board, not checked" in capsys.readouterr().err


def test_check_rejects_options_that_it_does_not_use(plane_folder, capsys):
    status = calibrate("planes", "--check", "camera.yaml")

    assert status == 2
    assert "leave out --camera, --output" in capsys.readouterr().err


@pytest.mark.slow
def test_the_mount_is_written_to_the_rig(plane_folder):
    from ringpose.files.rigs import read_rig

    (plane_folder / "mount.yaml").write_text(
        "mount: {tool_from_camera: [[0, -1, 0, 0.1], [1, 0, 0, 0], [0, 0, 1, 0.05], [0, 0, 0, 1]]}"
    )

    calibrate("planes", *ORDER, "--mount", "mount.yaml")

    tool_from_camera = read_rig(plane_folder / "rig.yaml").mount.carrier_from_camera
    assert tool_from_camera[:3, 3] == pytest.approx([0.1, 0.0, 0.05])


def test_a_file_without_a_mount_is_rejected(plane_folder, capsys):
    status = calibrate("planes", *ORDER, "--mount", "camera.yaml")

    assert status == 65
    assert "mount" in capsys.readouterr().err
