"""Poses by a rig that was calibrated from rendered boards, beside those by the true rig."""

import contextlib
import io
import json
from pathlib import Path

import pytest

from ringpose.cli.main import main

NOISE_ONLY = ("--still", "--ring-tolerance", "0", "--rig-stability", "0")
"""The board views and the rings were rendered with one rig."""


def errors_by_distance(shots, truth, rig) -> dict:
    """Root mean square errors and NEES by distance, of `ringpose bench`."""
    with contextlib.redirect_stdout(io.StringIO()) as lines:
        main(["pose", str(shots), "--rig", str(rig), "--quiet", *NOISE_ONLY])
    Path("poses.jsonl").write_text(lines.getvalue())
    main(["bench", "poses.jsonl", "--truth", str(truth), "--by", "distance_m", "--json", "bench.json", "--force"])
    groups = json.loads(Path("bench.json").read_text())["groups"]
    return {group["group"].get("distance_m", "all"): group for group in groups}


@pytest.fixture(scope="module")
def benched(shared_data, rig_of_rendered_boards, tmp_path_factory):
    """The rendered shots with the rig that the rendered boards give, and with the true one."""
    shots = shared_data / "rendered" / "rig_b"
    rigs = {"estimated": rig_of_rendered_boards, "true": shots / "rig.yaml"}
    with contextlib.chdir(tmp_path_factory.mktemp("benched")):
        return {name: errors_by_distance(shots / "shots", shots / "truth.jsonl", rig) for name, rig in rigs.items()}


@pytest.mark.slow
@pytest.mark.parametrize("distance_m", [0.3, 0.5])
def test_poses_by_the_estimated_rig_err_by_no_half_millimetre_more(distance_m, benched):
    """Where the boards were, 0.41 to 0.55 m; at 1 m the planes are extrapolated: see the next test."""
    estimated, true = (benched[name][distance_m]["errors"] for name in ("estimated", "true"))

    lengths = [name for name in true if name.endswith("_m")]
    assert max(estimated[name]["rmse"] - true[name]["rmse"] for name in lengths) < 0.5e-3


@pytest.mark.slow
def test_errors_of_poses_are_as_large_as_the_estimated_rig_says(benched):
    """24 shots share one calibration; mean NEES a dimension, of 18 centres and 22 normals."""
    nees = benched["estimated"]["all"]["nees"]

    assert 0.5 < nees["center_nees"] < 1.6
    assert 0.5 < nees["normal_nees"] < 1.7
