"""`ringpose detect --points`, and its points in `ringpose view`."""

import json
import re

import numpy as np
import pytest
from schemas import validated

from ringpose.cli.main import main
from ringpose.files.point_clouds import read_point_cloud


@pytest.fixture
def data_set(carried_data):
    return carried_data / "rig_b"


def test_points_on_the_face_of_rendered_rings_lie_there_within_their_sigmas(data_set, run):
    """Renders of another program; the rig is exact, so that the points' own noise is their whole error."""
    truths = {each["shot"]: each for each in map(json.loads, (data_set / "truth.jsonl").read_text().splitlines())}

    shots = [data_set / "shots" / f"{name}.npz" for name in ("B_z0500_p00_dim", "B_z0500_p01_dim")]

    found = run("detect", *shots, "--rig", data_set / "rig.yaml", "--points", "-")

    normalised = []
    for record in found.records:
        validated(record, "points")
        truth = truths[record["shot"]]
        normal, points = np.array(truth["normal"]), record["points"]
        offset_m = np.array(points["position_m"]) - truth["center_m"]
        height_m = offset_m @ normal
        radius_m = np.linalg.norm(offset_m - height_m[:, None] * normal, axis=1)
        inside = (radius_m > truth["radius_inner_m"] + 1e-3) & (radius_m < truth["radius_outer_m"] - 1e-3)
        on_face = inside & (np.abs(height_m) < 0.01)
        assert on_face.sum() > 100
        normalised.append(height_m[on_face] / np.abs(np.array(points["noise_m"])[on_face] @ normal))
    off = np.concatenate(normalised)
    assert 0.8 < np.sqrt(np.mean(off**2)) < 1.3
    assert np.mean(np.abs(off) > 3) < 0.01


@pytest.fixture
def cloud(data_set, tmp_path):
    shot, rig = str(data_set / "shots" / "B_z0500_p01_dim.npz"), str(data_set / "rig.yaml")
    for name in ("cloud.ply", "cloud.npz"):
        assert main(["detect", shot, "--rig", rig, "--points", str(tmp_path / name), "--quiet"]) == 0
    return tmp_path / "cloud.ply", shot, rig


def test_both_kinds_of_file_have_the_same_points(cloud):
    ply, npz = (read_point_cloud(cloud[0].with_suffix(suffix), 10_000) for suffix in (".ply", ".npz"))

    np.testing.assert_array_equal(ply.position_m, npz.position_m)
    assert (ply.shots, ply.frame) == (("B_z0500_p01_dim",), "camera")


def test_a_replay_shows_the_points_of_its_shots(cloud, tmp_path):
    file, shot, rig = cloud
    page = tmp_path / "v.html"

    assert main(["view", shot, "--rig", rig, "--points", str(file), "--html", str(page), "--quiet"]) == 0

    data = json.loads(re.search(r'id="data">(.*?)</script>', page.read_text(), re.DOTALL)[1])
    shown = np.concatenate([np.reshape(part["points_mm"], (-1, 3)) for part in data["cloud"]])
    assert len(shown) == len(read_point_cloud(file, 10_000).laser)
    assert data["shots"][0]["in_cloud"] == 0
    np.testing.assert_array_equal(data["shots"][0]["camera_from_cloud"], np.eye(4)[:3])


def test_points_of_other_shots_are_named(cloud, data_set, tmp_path, capsys):
    other, page = str(data_set / "shots" / "B_z1000_p01_dim.npz"), str(tmp_path / "v.html")

    assert main(["view", other, "--rig", cloud[2], "--points", str(cloud[0]), "--html", page, "--quiet"]) == 65
    assert "--points" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("words", "status", "finding"),
    [
        (["--frame", "base"], 2, "no use without --points"),
        (["--points", "c.txt"], 2, "neither a .ply"),
        (["--points", "-", "--output", "out"], 2, "both write on standard output"),
        (["--points", "c.ply", "--frame", "base"], 65, "has no mount"),
        (["--points", "c.ply", "--segments-only"], 2, "needs the rig"),
        (["--points", "c.ply", "--output", "out", "--resume"], 2, "exclude each other"),
    ],
)
def test_points_that_cannot_be_written_are_refused_beforehand(
    words, status, finding, data_set, tmp_path, monkeypatch, capsys
):
    monkeypatch.chdir(tmp_path)

    assert main(["detect", str(data_set / "shots"), "--rig", str(data_set / "rig.yaml"), *words]) == status

    assert finding in capsys.readouterr().err
    assert not (tmp_path / "c.ply").exists()
