"""Targets of parts and the models in the package, and the messages for invalid ones."""

import math

import numpy as np
import pytest
import yaml

from ringpose.errors import DataError
from ringpose.files.records.codec import OF_FILE, definition_of
from ringpose.files.scenes.motions import mass_properties
from ringpose.files.scenes.targets import MODELS, TargetEntry
from ringpose.files.scenes.targets import target_of as entered_target
from ringpose.files.schema import Fields
from ringpose.types.target import MATERIALS, Box

NAMES = sorted(path.stem for path in MODELS.glob("*.yaml"))

RING = {
    "name": "ring",
    "shape": "revolution",
    "profile_m": [[0.567, 0.0], [0.567, 0.06], [0.597, 0.06], [0.597, 0.0]],
    "edges": {"inner": 1, "outer": 2},
    "material": "metal",
}
BRIGHT = {"diffuse": 2, "specular": 0, "roughness": 1}
GAP = {"angle_rad": 0.5, "width_m": 0.1, "depth_m": 0.01}
BOX = {"name": "box", "shape": "box", "size_m": [1.0, 2.0, 3.0], "material": "foil", "mass_kg": 12}


def target_of(*parts, **values):
    fields = Fields("scene.yaml", {**({"parts": list(parts)} if parts else {}), **values}, path="target")
    return entered_target(fields, definition_of(TargetEntry).read(fields, OF_FILE))


def test_the_models_are_shipped():
    assert NAMES == ["bare", "ring-on-plate", "sinosat2"]
    assert target_of(model="bare").ring is None


def test_a_model_of_another_version_is_bad_data(tmp_path, monkeypatch):
    newer = (MODELS / "bare.yaml").read_text().replace("target/1", "target/2")
    (tmp_path / "newer.yaml").write_text(newer)
    monkeypatch.setattr("ringpose.files.scenes.targets.MODELS", tmp_path)

    with pytest.raises(DataError, match=r"newer\.yaml: ringpose: is 'target/2'"):
        target_of(model="newer")


@pytest.mark.parametrize("name", NAMES)
def test_every_number_of_a_model_is_cited_or_assumed(name):
    without_number = {"name", "shape", "material", "wall", "back", "state", "assumed", "cited", "edges"}
    for part in yaml.safe_load((MODELS / f"{name}.yaml").read_text())["parts"]:
        stated = {*part.get("assumed", ()), *part.get("cited", {})}
        assert part.keys() - without_number <= stated, part["name"]


def test_sinosat2_has_at_least_twelve_parts_and_a_ring_with_gaps():
    target = target_of(model="sinosat2")

    assert len(target.parts) >= 12
    assert len(target.ring.gaps) >= 4
    radii_m = target.ring.radius_inner_m, target.ring.radius_outer_m
    assert radii_m == pytest.approx((0.5695, 0.5965))  # less the chamfer
    assert target.ring.height_m == 0.05


def test_the_wings_of_sinosat2_span_more_than_a_hundred_feet_deployed():
    def span_m(state):
        ends = [part.translation_m[1] + part.shape.high_m[1] for part in target_of(model="sinosat2", state=state).parts
                if "wing" in part.name]  # fmt: skip
        return 2 * max(ends)

    assert span_m("deployed") > 30.48
    assert span_m("stowed") < 6


@pytest.mark.parametrize(("mass", "expected_kg"), [("fuelled", 5100), ("dry", 1974)])
@pytest.mark.parametrize("state", ["stowed", "deployed"])
def test_the_parts_of_sinosat2_add_up_to_its_mass(state, mass, expected_kg):
    target = target_of(model="sinosat2", state=state, mass=mass)
    mass_kg, _, _ = mass_properties(target.parts)

    assert mass_kg + target.ring.mass_kg == pytest.approx(expected_kg, rel=1e-3)


def test_deployed_wings_raise_the_inertia_across_them():
    (_, _, stowed), (_, _, deployed) = (
        mass_properties(target_of(model="sinosat2", state=state).parts) for state in ("stowed", "deployed")
    )

    moments = np.linalg.eigvalsh(deployed)
    assert deployed[0, 0] > 5 * stowed[0, 0]
    assert moments[2] <= moments[0] + moments[1]


def test_shapes_are_boxes_and_surfaces_of_revolution():
    target = target_of(
        BOX,
        {"name": "a", "shape": "cylinder", "radius_m": 0.1, "height_m": 0.3, "material": "white"},
        {"name": "b", "shape": "cone", "radius_m": 0.1, "top_radius_m": 0.2, "height_m": 0.3, "material": "white"},
        {"name": "c", "shape": "disc", "radius_m": 0.1, "inner_radius_m": 0.05, "material": "white"},
        {"name": "d", "shape": "panel", "size_m": [1, 2], "material": "solar-cells", "back": "black"},
        RING,
    )

    box, cylinder, cone, disc, panel = target.parts
    assert isinstance(box.shape, Box)
    np.testing.assert_array_equal(cylinder.shape.profile_m, [[0, 0], [0.1, 0], [0.1, 0.3], [0, 0.3]])
    np.testing.assert_array_equal(cone.shape.profile_m[1:3], [[0.1, 0], [0.2, 0.3]])
    np.testing.assert_array_equal(disc.shape.profile_m, [[0.05, 0], [0.1, 0]])
    assert panel.materials == (MATERIALS["solar-cells"], *[MATERIALS["black"]] * 5)
    assert target.ring.radius_outer_m == 0.597


def test_a_slope_raises_the_outer_edge_and_chamfers_follow_it():
    sloping = target_of({**RING, "slope_rad": 0.1}).ring
    chamfered = target_of({**RING, "slope_rad": 0.1, "chamfer_m": 0.001}).ring

    np.testing.assert_allclose(sloping.edge_heights_m, 0.06 + np.tan(0.1) * np.array([-0.015, 0.015]), atol=1e-12)
    lower_m, higher_m = chamfered.edge_heights_m
    width_m = chamfered.radius_outer_m - chamfered.radius_inner_m
    assert np.arctan2(higher_m - lower_m, width_m) == pytest.approx(0.1, abs=1e-12)


def test_a_chamfer_moves_the_edges_of_the_face_inward():
    ring = target_of({**RING, "chamfer_m": 0.001}).ring

    assert ring.radius_inner_m == pytest.approx(0.568)
    assert ring.radius_outer_m == pytest.approx(0.596)
    assert ring.height_m == 0.06
    assert len(ring.profile_m) == 6


def test_the_form_of_a_ring_is_drawn_with_its_tolerance():
    rings = [target_of({**RING, "form": {"tolerance_m": 0.001, "seed": seed}}).ring for seed in range(60)]

    angle = np.arange(0.0, 6.0, 0.1)
    waves = np.array([[np.cos(k * angle), np.sin(k * angle)] for k in (2, 3, 4)])
    axial = np.array([np.einsum("ow,own->n", ring.form.axial_m, waves) for ring in rings])
    assert axial.std() == pytest.approx(0.001, rel=0.1)


def test_moments_of_a_box_and_of_a_hoop_are_those_of_textbooks():
    (box,) = target_of(BOX).parts
    hoop = {"name": "hoop", "shape": "disc", "radius_m": 1.0, "inner_radius_m": 0.9999, "material": "metal"}

    _, center, inertia = mass_properties([box])
    np.testing.assert_allclose(np.diag(inertia), [13.0, 10.0, 5.0])
    np.testing.assert_allclose(center, 0.0, atol=1e-15)
    _, _, of_hoop = mass_properties(target_of(hoop | {"mass_kg": 3}).parts)
    np.testing.assert_allclose(np.diag(of_hoop), [1.5, 1.5, 3.0], rtol=1e-3)


def test_the_inertia_of_two_parts_has_their_distance():
    far = {**BOX, "name": "far", "position_m": [4.0, 0, 0], "rotation_rad": [0, 0, math.pi / 2]}

    mass_kg, center, inertia = mass_properties(target_of(BOX, far).parts)

    assert mass_kg == 24
    np.testing.assert_allclose(center, [2.0, 0, 0], atol=1e-12)
    np.testing.assert_allclose(np.diag(inertia), [23.0, 23.0 + 96.0, 10.0 + 96.0])


@pytest.mark.parametrize(
    ("values", "place", "word"),
    [
        *(
            ({"parts": [part]}, f"target.{place}", word)
            for part, place, word in (
                ({**BOX, "shape": "sphere"}, "parts[0].shape", "box"),
                ({**BOX, "radius_m": 1.0}, "parts[0]", "unknown key"),
                ({**BOX, "material": "gold"}, "parts[0].material", "metal"),
                ({**BOX, "size_m": [1000, 2000, 3000]}, "parts[0].size_m", "millimetres"),
                ({**BOX, "size_m": [1.0, -2.0, 3.0]}, "parts[0].size_m", "positive"),
                ({**BOX, "rotation_rad": [0, 0, 90]}, "parts[0].rotation_rad", "degrees"),
                ({**BOX, "state": "stowed"}, "parts[0]", "unknown key"),
                (
                    {**BOX, "material": BRIGHT},
                    "parts[0].material.diffuse",
                    "at most 1",
                ),
                ({**RING, "edges": {"inner": 0, "outer": 2}}, "parts[0].edges", "neighbouring"),
                ({**RING, "edges": {"inner": 2, "outer": 1}}, "parts[0].edges", "exchanged"),
                ({**RING, "position_m": [0, 0, 1]}, "parts[0].position_m", "target frame"),
                ({**RING, "gaps": [GAP | {"angle_rad": 45}]}, "parts[0].gaps[0].angle_rad", "degrees"),
                ({**RING, "chamfer_m": 0.02}, "parts[0].chamfer_m", "too large"),
                ({**RING, "form": {"inner_m": [[1, 0], [0, 0], [0, 0]]}}, "parts[0].form.inner_m", "millimetres"),
                ({**{k: v for k, v in RING.items() if k != "edges"}, "gaps": []}, "parts[0].gaps", "edges"),
            )
        ),
        ({}, "target", "model"),
        ({"model": "sinosat3"}, "target.model", "sinosat2"),
        ({"model": "sinosat2", "state": "folded"}, "target.state", "stowed"),
        ({"model": "bare", "state": "stowed"}, "target.state", "no states"),
        ({"parts": [BOX], "mass": "dry"}, "target.mass", "model"),
        ({"parts": [BOX, BOX]}, "target.parts[1].name", "twice"),
        ({"parts": [RING, {**RING, "name": "other"}]}, "target.parts[1].edges", "one interface ring"),
        ({"model": "ring-on-plate", "parts": [RING]}, "target.parts", "ring"),
    ],
)
def test_invalid_targets_are_rejected_with_their_place(values, place, word):
    with pytest.raises(DataError) as error:
        target_of(**values)

    assert error.value.location == f"scene.yaml: {place}"
    assert word in str(error.value)
