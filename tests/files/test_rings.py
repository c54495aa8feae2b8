"""Reading of ring catalogues."""

import numpy as np
import pytest

from ringpose.errors import DataError
from ringpose.files.rings import read_rings

MINE = """
ringpose: rings/1
rings:
- name: mine
  radius_inner_m: [0.5665, 0.5675]
  radius_outer_m: [0.5965, 0.5975]
"""


@pytest.mark.parametrize(("name", "diameter_mm"), [(f"nominal-{mm}", mm) for mm in (937, 1194, 1666, 2624)])
def test_shipped_outer_radii_are_about_half_the_nominal_diameter(name, diameter_mm):
    ring = next(ring for ring in read_rings() if ring.name == name)

    assert ring.radius_outer_m[0] < diameter_mm / 2000 < ring.radius_outer_m[1]


def test_shipped_rings_state_that_their_source_is_a_nominal_diameter():
    assert all("interface diameter" in ring.source for ring in read_rings())


def test_an_interval_has_the_moments_of_a_uniform_distribution(tmp_path):
    (tmp_path / "rings.yaml").write_text(MINE)

    (ring,) = read_rings(tmp_path / "rings.yaml")

    np.testing.assert_allclose(ring.known_radii.radius_m, [0.567, 0.597])
    np.testing.assert_allclose(ring.known_radii.sd_m, 0.001 / np.sqrt(12))


@pytest.mark.parametrize(
    ("text", "finding"),
    [
        *(
            (MINE.replace(old, new), finding)
            for old, new, finding in (
                ("0.5665, 0.5675", "0.5675, 0.5665", "must be two positive radii, the smaller one first"),
                ("0.5665, 0.5675", "566.5, 567.5", "0.5675 if it is in millimetres"),
                ("0.5665, 0.5675", "0.5665, 0.597", "must end below the outer edge's 0.5965"),
                ("mine", "auto", "is taken"),
                ("mine", "none of these", "is taken"),
                ("rings/1", "rings/2", "must be one of rings/1"),
                ("radius_inner_m", "inner_m", "unknown key 'inner_m'"),
                ("name: mine", "name: mine\n  source: a\n  tolerance_m: 0.2", "tolerance_m: is 0.2, must be 0 to 0.05"),
                ("name: mine", "name: mine\n  tolerance_m: 0.0003", "tolerance_m: has no source"),
            )
        ),
        (MINE + MINE.split("rings:\n")[1], "'mine' is taken"),
        ("ringpose: rings/1\nrings: []\n", "has no ring"),
    ],
)
def test_an_invalid_catalogue_is_rejected(tmp_path, text, finding):
    (tmp_path / "rings.yaml").write_text(text)

    with pytest.raises(DataError, match=finding):
        read_rings(tmp_path / "rings.yaml")
