"""Clear ends: stripes on foil hardly have any; and the contribution of visible edges beside a single stripe."""

import json
from dataclasses import replace

import numpy as np
import pytest
from drawn_scene import DrawnScene, draw_shot
from ring_scenes import break_points_of

from ringpose.detect.break_points import ends_clear
from ringpose.detect.pipeline import detect
from ringpose.files.images.shots import read_shot
from ringpose.files.rigs import read_rig
from ringpose.types.detection import BreakPointFlag, BreakPoints, NoBreakPoints
from ringpose.types.image import shot_with_frames


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


TURNED = (slice(None, None, -1), slice(None, None, -1))
MIRRORED = (slice(None, None, -1), slice(None))


@pytest.mark.parametrize(
    ("name", "turned", "reason"),
    [
        ("B_z0300_p00_strong", TURNED, NoBreakPoints.CONTRADICTED_RIG),
        ("B_z0300_p00_strong", MIRRORED, NoBreakPoints.UPSIDE_DOWN),
        ("B_z0500_p00_normal", TURNED, NoBreakPoints.UPSIDE_DOWN),
        ("B_z0500_p00_normal", MIRRORED, NoBreakPoints.UPSIDE_DOWN),
    ],
)
def test_a_shot_that_is_upside_down_is_named(shared_data, name, turned, reason):
    folder = shared_data / "rendered" / "rig_b"
    shot = read_shot(folder / "shots" / f"{name}.npz")
    images = np.ascontiguousarray(shot.images[:, *turned])

    found = detect(replace(shot, images=images), read_rig(folder / "rig.yaml")).break_points

    assert found is reason


@pytest.mark.parametrize("full_dn", [255, 65535], ids=["single exposure", "merged exposures"])
def test_a_laser_that_is_on_in_the_frame_without_one_is_named(rig, rng, full_dn):
    shot = draw_shot(DrawnScene(), rig, [0, 7], rng)
    images = shot.images[::-1].astype(np.min_scalar_type(full_dn))
    images[:, -1, -1] = full_dn
    meta = {"saturation_dn": full_dn, "usual_full_dn": 255}

    found = detect(replace(shot, images=images, meta=meta), rig).break_points

    assert found is NoBreakPoints.DARK_FRAME_LIT


def test_visible_edges_stand_for_clear_ends_beside_several_stripes_without_a_background(shared_data):
    folder = shared_data / "rendered" / "variants_b"
    rig, shot = read_rig(folder / "rig.yaml"), read_shot(folder / "shots" / "V03_occl_B500_strong.npz")
    lit = shot_with_frames(shot, np.flatnonzero(shot.lasers))

    found = detect(lit, rig)

    assert isinstance(found.break_points, BreakPoints)
    assert not ends_clear(found.break_points)
    assert found.ring_edges is not None
