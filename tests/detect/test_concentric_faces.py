"""Two faces at one height about one axis: which is the ring's is open; a groove is part of a face."""

import numpy as np
import pytest
from flat_stripes import height_m, segment_on_plane
from ring_scenes import PROJECTED, make_camera

from ringpose.detect.concentric_faces import several_faces
from ringpose.detect.rim import ring_face
from ringpose.kernels.lines import X_END, X_START
from ringpose.types.detection import JudgedRing
from ringpose.types.rig import Rig

RIG = Rig(camera=make_camera((1600, 1200), (1778.0, 1778.0), (800.0, 600.0)), lasers=PROJECTED)
Z_M = 0.5


def segment(laser: int, from_m: float, to_m: float, z_m: float = Z_M) -> np.ndarray:
    """A laser's stripe between two places x on the plane at that depth, as one segment."""
    return segment_on_plane(RIG, laser, (from_m, to_m), z_m)


def stripes(bands_m, axis_m, between_m=None) -> np.ndarray:
    """Segments of all lasers on flat bands about an axis at x, y = 0, to its right, and on what is between them."""
    rows = []
    for laser in range(3):
        y_m = height_m(RIG, laser, Z_M)
        ends_m = [axis_m + np.sqrt(np.square(band) - y_m**2) for band in bands_m]
        rows += [segment(laser, *ends) for ends in ends_m]
        if between_m is not None:
            rows.append(segment(laser, ends_m[0][1] + 0.001, ends_m[1][0] - 0.001, Z_M + between_m))
    return np.array(rows)


def judged(axis_m: float, radius_m: float) -> JudgedRing:
    return JudgedRing(
        origin_m=np.array([axis_m + radius_m, 0.0, Z_M]),
        axes=np.array([[-1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, -1.0]]),
        curvature_per_m=1.0 / radius_m,
        half_band_m=0.01,
        velocity_m_s=np.zeros(3),
        rate_rad_s=np.zeros(3),
        stamp_s=None,
    )


TWO_BANDS = ((0.25, 0.27), (0.29, 0.32))


@pytest.mark.parametrize("known", [True, False], ids=["by the judged ring", "by straight edges"])
@pytest.mark.parametrize(
    ("bands_m", "between_m", "several"),
    [
        (TWO_BANDS, 0.06, True),
        (TWO_BANDS, None, True),
        (TWO_BANDS, 0.003, False),
        (TWO_BANDS, -0.006, False),
        (((0.29, 0.32),), None, False),
    ],
    ids=["the body between them", "nothing between them", "a groove", "something on the face", "one face"],
)
def test_another_face_about_the_same_axis_is_seen(bands_m, between_m, several, known):
    segments = stripes(bands_m, -0.3, between_m)
    face = ring_face(segments, (), RIG)

    assert face.lasers == (0, 1, 2)
    assert several_faces(face, segments, (), judged(-0.3, 0.3) if known else None, RIG) == several


def test_gaps_at_other_distances_from_the_axis_are_not_another_face():
    """As where a rod lies deep behind a slit that crosses the face at an angle."""
    rows = []
    for laser, shift_m in enumerate((-0.02, 0.0, 0.02)):
        left, right = stripes(((0.25, 0.32),), -0.3)[laser][[X_START, X_END]]
        left_m, right_m = (np.array([left, right]) - 800.0) * Z_M / 1778.0
        middle_m = (left_m + right_m) / 2 + shift_m
        rows += [segment(laser, left_m, middle_m - 0.005), segment(laser, middle_m + 0.005, right_m)]
        rows.append(segment(laser, middle_m - 0.004, middle_m + 0.004, Z_M + 0.06))
    segments = np.array(rows)
    face = ring_face(segments, (), RIG)

    assert face is not None
    assert not several_faces(face, segments, (), judged(-0.3, 0.285), RIG)
