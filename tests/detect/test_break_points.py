"""Clear ends: stripes on foil hardly have any; and the contribution of visible edges beside a single stripe."""

import json
from dataclasses import replace

import numpy as np
import pytest
from ring_scenes import break_points_of

from ringpose.detect.break_points import ends_clear
from ringpose.detect.pipeline import detect
from ringpose.files.images.shots import read_shot
from ringpose.files.rigs import read_rig
from ringpose.types.detection import BreakPointFlag, BreakPoints, NoBreakPoints


def found_ends(seen: int, unclear: int) -> BreakPoints:
    """Six ends, of which so many are seen, and so many of these unclear."""
    position = np.full((6, 2), np.nan)
    position[:seen] = 1.0
    flags = np.where(np.arange(6) < unclear, int(BreakPointFlag.UNCLEAR), 0)
    return replace(break_points_of(position.reshape(3, 2, 2), 1.0), flags=flags.reshape(3, 2), labelled=False)


@pytest.mark.parametrize(
    ("seen", "unclear", "clear"), [(6, 4, True), (6, 5, False), (2, 0, True), (2, 1, False), (1, 0, True), (0, 0, True)]
)
def test_two_clear_ends_or_all_that_are_seen_make_a_face(seen, unclear, clear):
    assert ends_clear(found_ends(seen, unclear)) is clear


@pytest.mark.parametrize(("rig", "name"), [("rig_b", "B_z0300_p00_strong"), ("variants_b", "V12_glare_B500_glare")])
def test_stripes_on_foil_alone_are_not_a_ring(shared_data, rig, name):
    folder = shared_data / "rendered" / rig
    lines = map(json.loads, (folder / "truth.jsonl").read_text().splitlines())
    ends_px = next(
        np.array([each for each in line["break_points_px"] if each]) for line in lines if line["shot"] == name
    )
    shot = read_shot(folder / "shots" / f"{name}.npz")
    (left, top), (right, bottom) = ends_px.min((0, 1)).astype(int) - 8, ends_px.max((0, 1)).astype(int) + 8
    images = shot.images.copy()
    images[shot.lasers > 0, top:bottom, left:right] = images[shot.lasers == 0][:1, top:bottom, left:right]

    found = detect(replace(shot, images=images), read_rig(folder / "rig.yaml"), edges=False).break_points

    assert isinstance(found, NoBreakPoints)


@pytest.mark.parametrize(("name", "edges"), [("B_z0200_p01_normal", None), ("B_z0200_p01_strong", {0, 1})])
def test_beside_a_single_stripe_one_edge_alone_is_none(shared_data, name, edges):
    folder = shared_data / "rendered" / "rig_b"
    shot = read_shot(folder / "shots" / f"{name}.npz")

    found = detect(shot, read_rig(folder / "rig.yaml"))

    assert isinstance(found.break_points, BreakPoints)
    assert (None if found.ring_edges is None else set(found.ring_edges.edge.tolist())) == edges


def test_edges_are_followed_from_stripes_in_dim_light(shared_data):
    folder = shared_data / "rendered" / "variants_a"
    shot = read_shot(folder / "shots" / "V16_lowpower_A1000_dim.npz")

    found = detect(shot, read_rig(folder / "rig.yaml")).ring_edges

    assert found is not None
    assert len(found.edge) > 100


@pytest.mark.parametrize(
    "turned", [(slice(None, None, -1), slice(None, None, -1)), (slice(None, None, -1), slice(None))]
)
@pytest.mark.parametrize("name", ["B_z0300_p00_strong", "B_z0500_p00_normal"])
def test_a_shot_that_is_upside_down_is_named(shared_data, name, turned):
    folder = shared_data / "rendered" / "rig_b"
    shot = read_shot(folder / "shots" / f"{name}.npz")
    images = np.ascontiguousarray(shot.images[:, *turned])

    found = detect(replace(shot, images=images), read_rig(folder / "rig.yaml")).break_points

    assert isinstance(found, NoBreakPoints)
    assert "upside down" in found.value
