"""Point clouds as files, read by another library, and for a picture."""

import json
import tracemalloc
from dataclasses import replace

import numpy as np
import pytest
from needed import needed_module
from schemas import validated
from whole_records import record_of

from ringpose.errors import RingposeError
from ringpose.files.point_clouds import point_cloud_file, read_point_cloud
from ringpose.files.records.points import points_record
from ringpose.types.options import PoseFrame
from ringpose.types.points import LeftOut, ShotPoints, StripePoints

LASERS = ("left", "middle", "right")


@pytest.fixture
def rng(request):
    return np.random.default_rng(list(request.node.name.encode()))


def shot_points(rng, count=50, shot="a"):
    roots = rng.normal(size=(count, 3, 3))
    points = StripePoints(
        position_m=rng.normal(size=(count, 3)),
        covariance_m2=roots @ roots.swapaxes(1, 2),
        noise_m=rng.normal(size=(count, 3)),
        intensity_dn=rng.uniform(0, 255, count),
        laser=rng.integers(0, 3, count),
        stamp_s=1.7e9 + rng.uniform(size=count),
        position_px=rng.uniform(0, 1000, (count, 2)),
    )
    return ShotPoints(
        shot=shot,
        stamp_s=1.7e9,
        frame=PoseFrame.BASE,
        lasers=LASERS,
        points=points,
        left_out=LeftOut(laser_unknown=3),
        calibration_covariance=True,
    )


def written(path, shots, **options):
    given = {"force": False, "inputs": []} | options
    with point_cloud_file(path, PoseFrame.BASE, LASERS, **given) as cloud:
        for shot in shots:
            cloud.add(shot)
    return path


def test_a_ply_file_is_read_by_another_library(rng, tmp_path):
    plyfile = needed_module("plyfile", "plyfile")
    shots = [shot_points(rng, 50, "a"), shot_points(rng, 0, "empty"), shot_points(rng, 20, 'ü "b"')]

    cloud = plyfile.PlyData.read(written(tmp_path / "c.ply", shots))

    vertex = cloud["vertex"]
    joined = [np.concatenate([getattr(shot.points, key) for shot in shots]) for key in ("position_m", "covariance_m2")]
    np.testing.assert_array_equal(np.stack([vertex[axis] for axis in "xyz"], axis=1), joined[0])
    for name, (row, column) in {"xx": (0, 0), "xy": (0, 1), "xz": (0, 2), "yz": (1, 2), "zz": (2, 2)}.items():
        np.testing.assert_array_equal(vertex[f"cov_{name}"], joined[1][:, row, column])
    assert vertex["laser"].tolist() == [*shots[0].points.laser, *shots[2].points.laser]
    assert vertex["shot"].tolist() == 50 * [0] + 20 * [2]
    about, *names = cloud.comments
    assert json.loads(about.removeprefix("ringpose "))["frame"] == "base"
    assert [json.loads(name.removeprefix("shot ")) for name in names] == ["a", "empty", 'ü "b"']


def test_an_npz_file_has_the_arrays_of_the_record(rng, tmp_path):
    shots = [shot_points(rng, 50, "a"), shot_points(rng, 20, "b")]

    with np.load(written(tmp_path / "c.npz", shots)) as cloud:
        for key in ("position_m", "covariance_m2", "noise_m", "intensity_dn", "laser", "stamp_s", "position_px"):
            expected = np.concatenate([getattr(shot.points, key) for shot in shots])
            np.testing.assert_array_equal(cloud[key], expected)
        assert (cloud["shots"].tolist(), cloud["lasers"].tolist()) == (["a", "b"], list(LASERS))
        assert cloud["shot"].tolist() == 50 * [0] + 20 * [1]
        assert str(cloud["frame"]) == "base"


def test_the_record_is_valid_also_with_points_of_unknown_errors(rng):
    shot = shot_points(rng, 4)
    unknown = np.where(np.arange(4)[:, None, None] == 1, np.nan, shot.points.covariance_m2)
    shot = replace(shot, points=replace(shot.points, covariance_m2=unknown))

    record = record_of(points_record(shot))

    validated(record, "points")
    assert record["points"]["covariance_m2"][1][0] == [None, None, None]


@pytest.mark.parametrize("suffix", ["ply", "npz"])
def test_a_large_cloud_is_thinned_for_a_picture(suffix, rng, tmp_path):
    shots = [shot_points(rng, 70_001, "a"), shot_points(rng, 20, "b")]

    cloud = read_point_cloud(written(tmp_path / f"c.{suffix}", shots), 30_000)

    whole_m = np.concatenate([shot.points.position_m for shot in shots])
    assert (cloud.thinned_by, cloud.frame, cloud.shots) == (3, PoseFrame.BASE, ("a", "b"))
    np.testing.assert_array_equal(cloud.position_m, whole_m[::3])
    assert cloud.shot[-1] == 1


def test_an_interrupted_cloud_leaves_no_file(rng, tmp_path):
    def shots():
        yield shot_points(rng)
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        written(tmp_path / "c.ply", shots())

    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("suffix", ["ply", "npz"])
def test_the_memory_does_not_depend_on_the_number_of_shots(suffix, rng, tmp_path):
    shot = shot_points(rng, 10_000)
    tracemalloc.start()
    try:
        file = written(tmp_path / f"c.{suffix}", 10 * [shot])
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()

    assert file.stat().st_size > 10_000_000
    assert peak < 0.8 * file.stat().st_size


@pytest.mark.parametrize(
    ("name", "encoded", "word"),
    [
        ("c.ply", b"ply\nformat ascii 1.0\nelement vertex 1\nend_header\n0 0 0\n", "other properties"),
        ("c.ply", b"\xff\xfe\n", "not a PLY file"),
        ("c.npz", b"PK\x03\x04", "NPZ archive"),
        ("c.txt", b"", "neither a .ply"),
    ],
)
def test_a_file_of_another_kind_is_named(name, encoded, word, tmp_path):
    (tmp_path / name).write_bytes(encoded)

    with pytest.raises(RingposeError, match=word):
        read_point_cloud(tmp_path / name, 10)


def test_a_truncated_cloud_is_named(rng, tmp_path):
    file = written(tmp_path / "c.ply", [shot_points(rng)])
    file.write_bytes(file.read_bytes()[:-1])

    with pytest.raises(RingposeError, match="50 points"):
        read_point_cloud(file, 10)
