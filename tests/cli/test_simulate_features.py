"""`ringpose simulate --features`: records or files, with truth; what it rejects."""

import json
from pathlib import Path

import numpy as np
import pytest
from small_rig import SERVED_RIG, write_scene

from ringpose.files.npz import Archive
from ringpose.files.records.detections import detection_in
from ringpose.files.records.truths import read_truths


@pytest.fixture
def scene(tmp_path: Path) -> Path:
    lines = ("sensor: {pixel_m: 3.6e-5}", "stripe_dn: 150", "sequence: off,1,2,3")
    return write_scene(tmp_path, *lines, rig=SERVED_RIG)


@pytest.fixture
def features(run, scene):
    return lambda *words: run("simulate", scene, "--features", *words)


def test_records_are_written_to_stdout(features):
    found = features()

    assert found.status == 0
    assert [record["shot"] for record in found.records] == ["z0500_p00_dim", "z0500_p01_dim", "z0500_p02_dim"]
    assert np.shape(found.records[0]["break_points"]["position_px"]) == (3, 2, 2)


def test_a_folder_has_rig_detections_and_truth(features, scene):
    out = scene.parent / "out"

    status, names, _ = features("--output", out, "--max-speed", 0.1, "--max-rate", 5)

    truths = list(read_truths(out / "truth.jsonl"))
    assert (status, len(names), (out / "rig.yaml").is_file()) == (0, 3, True)
    assert [Path(name).stem for name in names] == [truth.shot for truth in truths]
    for name, truth in zip(names, truths, strict=True):
        archive = Archive(Path(name))
        assert detection_in(archive).stamp_s == truth.stamp_s
        assert str(scene) in json.loads(str(archive.value("provenance")))["inputs"]
        assert 0 < np.linalg.norm(truth.velocity_m_s) < 0.3
        assert truth.angular_velocity_rad_s @ truth.normal == pytest.approx(0.0, abs=1e-9)


def test_the_same_seed_gives_the_same_features(features):
    runs = [features("--seed", seed, "--ring-tolerance", 0.001, "--displaced", 0.3).records for seed in (1, 1, 2)]

    assert runs[0] == runs[1]
    assert runs[0] != runs[2]


def test_outliers_are_named_in_the_truth(features, scene):
    out = scene.parent / "out"

    features("-o", out, "--displaced", "1:4,5", "--background", "1:0.01,0.02", "--missing", 0)

    groups = next(read_truths(out / "truth.jsonl")).groups
    assert groups["displaced"] == "left.inner,left.outer,middle.inner,middle.outer,right.inner,right.outer"
    assert groups["background"] == "left,middle,right"
    assert "missing" not in groups


def test_what_exists_is_replaced_with_force_only(features, scene):
    out = scene.parent / "out"
    features("-o", out)

    status, _, messages = features("-o", out, "--count", 1)

    assert status == 73
    assert "--force" in messages[0]
    assert features("-o", out, "--count", 1, "--force").status == 0
    assert len(list((out / "detections").iterdir())) == 1


@pytest.mark.parametrize(
    ("options", "status", "named"),
    [
        ("--features --displaced 2", 2, "--displaced"),
        ("--features --displaced 0.1:5,3", 2, "--displaced"),
        ("--features --background often", 2, "--background"),
        ("--features --missing 1.5", 2, "--missing"),
        ("--features --max-speed -1", 2, "--max-speed"),
        ("--features --ring-tolerance nan", 2, "--ring-tolerance"),
        ("--features --max-rate 1", 2, "--max-rate"),  # the scene has a motion
        ("--features --rig-errors", 65, "covariance"),  # the rig has none, and no stability
        ("--output out --max-speed 0.1", 2, "--features"),
        ("", 2, "--output"),
    ],
)
def test_bad_usage_is_reported(run, scene, monkeypatch, options, status, named):
    monkeypatch.chdir(scene.parent)
    if "--max-rate" in options:
        scene.write_text(scene.read_text() + "motion: {preset: geo-bound}\n")
    exact = "stability: {plane_tilt_rad: 0, plane_distance_m: 0, focal_ratio: 0}\n"
    (scene.parent / "rig.yaml").write_text(SERVED_RIG + exact)

    found = run("simulate", scene, *options.split())

    assert found.status == status
    assert named in found.messages[0]
