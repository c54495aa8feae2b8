"""Reading of ring catalogues."""

import re

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


def test_shipped_rings_state_their_source():
    sources = [ring.source for ring in read_rings()]

    assert all(re.match("interface diameter|EN 1092-1 DN|ASME B16.5 NPS", source) for source in sources)


ASME_INCHES = {  # raised face (R) and inner diameter of a pipe with standard wall (ASME B36.10)
    "2": (3.62, 2.067), "2.5": (4.12, 2.469), "3": (5.0, 3.068), "4": (6.19, 4.026), "5": (7.31, 5.047),
    "6": (8.5, 6.065), "8": (10.62, 7.981), "10": (12.75, 10.02), "12": (15.0, 12.0), "14": (16.25, 13.25),
    "16": (18.5, 15.25), "18": (21.0, 17.25), "20": (23.0, 19.25), "24": (27.25, 23.25),
}  # fmt: skip


@pytest.mark.parametrize("nps", ASME_INCHES)
def test_shipped_asme_flanges_agree_with_the_tables_in_inches(nps):
    ring = next(ring for ring in read_rings() if ring.name == f"asme-nps{nps}")
    face_m, bore_m = (0.5 * 0.0254 * inches for inches in ASME_INCHES[nps])

    assert ring.radius_outer_m[0] + 0.0009 < face_m < ring.radius_outer_m[1] - 0.0004
    assert ring.radius_inner_m[0] < bore_m < ring.radius_inner_m[1]


EN_BOLTS_MM = {  # bolt circle K and hole L
    "50-pn10-40": (125, 18), "65-pn10-40": (145, 18), "80-pn10-40": (160, 18), "100-pn10-16": (180, 18),
    "100-pn25-40": (190, 22), "125-pn10-40": (210, 18), "150-pn10-16": (240, 22), "150-pn25-40": (250, 26),
    "200-pn10-16": (295, 22), "200-pn25": (310, 26), "200-pn40": (320, 30), "250-pn10-16": (350, 22),
    "250-pn25": (370, 30), "250-pn40": (385, 33), "300-pn10": (400, 22), "300-pn16": (410, 26), "300-pn25": (430, 30),
    "300-pn40": (450, 33), "350-pn10": (460, 22), "350-pn16": (470, 26), "350-pn25": (490, 33), "350-pn40": (510, 36),
    "400-pn10": (515, 26), "400-pn16": (525, 30), "400-pn25": (550, 36), "400-pn40": (585, 39), "450-pn10": (565, 26),
    "450-pn16": (585, 30), "450-pn25": (600, 36), "450-pn40": (610, 39), "500-pn10": (620, 26), "500-pn16": (650, 33),
    "500-pn25-40": (660, 36), "600-pn10": (725, 30), "600-pn16": (770, 36), "600-pn25": (770, 39),
    "600-pn40": (795, 48),
}  # fmt: skip

PIPES_MM = {
    50: 60.3, 65: 76.1, 80: 88.9, 100: 114.3, 125: 139.7, 150: 168.3, 200: 219.1, 250: 273.0, 300: 323.9, 350: 355.6,
    400: 406.4, 450: 457.0, 500: 508.0, 600: 610.0,
}  # fmt: skip
"""Outer diameters of pipes (ISO 4200)."""


@pytest.mark.parametrize("name", EN_BOLTS_MM)
def test_shipped_en_flanges_have_a_bore_about_the_pipe_and_a_face_that_ends_just_inside_the_bolt_holes(name):
    ring = next(ring for ring in read_rings() if ring.name == f"en1092-dn{name}")
    circle_mm, hole_mm = EN_BOLTS_MM[name]
    gap_mm = 0.5 * (circle_mm - hole_mm) - 1000 * ring.radius_outer_m[1]

    assert 0.5 < gap_mm < 6.0
    pipe_m = 0.0005 * PIPES_MM[int(name.split("-")[0])]
    assert ring.radius_inner_m[0] < pipe_m - 0.0029
    assert pipe_m < ring.radius_inner_m[1] < pipe_m + 0.004


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
