"""Objects without a ring: straight bars, and stripes whose ends saturated ambient light hides."""

from dataclasses import replace

import numpy as np
import pytest
from recorded_shots import make_shot
from ring_scenes import RIGS, break_points_of, pixels_of

from ringpose.detect.break_points import without_outliers
from ringpose.detect.difference_images import LaserImage, exposure_advice, hidden_by_saturation, saturated_along_stripes
from ringpose.types.detection import BreakPointFlag, BreakPoints, NoBreakPoints

RIG = replace(RIGS["B"], camera=replace(RIGS["B"].camera, distortion_coefficients=np.zeros(5)))
SIGMA_PX = 0.2
HALF_WIDTH_M = 0.015


def bar_ends(distance_m: float, bend_per_m: float, rng: np.random.Generator) -> BreakPoints:
    """Ends of the stripes on a bar that faces the camera, its middle line x = -bend y^2 / 2."""
    points = np.full((3, 2, 3), np.nan)
    for laser, (m, d) in enumerate(zip(RIG.lasers.normal, RIG.lasers.distance_m, strict=True)):
        for edge, side in enumerate((1, -1)):
            x = 0.0
            for _ in range(20):
                y = (d - m[0] * x - m[2] * distance_m) / m[1]
                x = side * HALF_WIDTH_M - bend_per_m * y**2 / 2
            points[laser, edge] = x, y, distance_m
    exact = pixels_of(points, RIG.camera)
    noisy = exact + rng.normal(0, SIGMA_PX, (3, 2, 1)) * [1.0, 0.0]
    return replace(
        break_points_of(noisy, SIGMA_PX),
        face_start_undistorted_px=exact[:, 1],
        face_end_undistorted_px=exact[:, 0],
        face_sigma_px=np.full((3, 2), 0.05),
    )


@pytest.mark.parametrize("distance_m", [0.3, 0.5, 1.0])
def test_the_stripes_on_a_straight_bar_are_not_on_a_ring(distance_m, rng):
    found = without_outliers(bar_ends(distance_m, 0.0, rng), RIG).break_points

    assert found is NoBreakPoints.STRAIGHT_EDGES


@pytest.mark.parametrize("radius_m", [0.35, 0.6, 1.3])
def test_the_stripes_on_a_bent_bar_may_be_on_a_ring(radius_m, rng):
    assert isinstance(without_outliers(bar_ends(0.4, 1 / radius_m, rng), RIG).break_points, BreakPoints)


def faces(saturated_ends: int) -> tuple[BreakPoints, LaserImage]:
    """Three stripes on a face at columns 100 to 150, the light beside some of their ends saturated."""
    x, y = np.array([150.0, 100.0]), np.array([20.0, 60.0, 100.0])
    position = np.stack(np.broadcast_arrays(x, y[:, None]), axis=-1)
    points = replace(
        break_points_of(position, SIGMA_PX),
        face_start_undistorted_px=position[:, 1],
        face_end_undistorted_px=position[:, 0],
    )
    dark = np.full((120, 250), 40, np.uint8)
    for end in range(saturated_ends):
        row, column = int(y[end // 2]), 151 if end % 2 == 0 else 85
        dark[row - 8 : row + 9, column : column + 15] = 255
    image = LaserImage(lit=dark, dark=dark, saturation_dn=255, lasers=(0, 1, 2), stamp_s=0.0, threshold_scale_dn=255)
    return points, image


@pytest.mark.parametrize("with_background", [True, False])
@pytest.mark.parametrize(("saturated_ends", "hidden"), [(0, False), (2, False), (3, True), (6, True)])
def test_saturated_light_beside_half_of_the_ends_hides_them(saturated_ends, hidden, with_background):
    points, image = faces(saturated_ends)
    image = image if with_background else replace(image, dark=None)

    assert hidden_by_saturation(points, [image], 255) is hidden


@pytest.mark.parametrize("with_background", [True, False])
@pytest.mark.parametrize(("share", "hidden"), [(0.0, False), (0.3, False), (0.7, True)])
def test_stripes_seen_only_where_the_light_does_not_saturate_are_no_face(share, hidden, with_background):
    points, image = faces(0)
    dark = image.lit.copy()
    dark[:, 175:] = 255
    dark[:, : int(share * 250) - 75 if share > 0.3 else 0] = 255
    image = replace(image, lit=dark, dark=dark if with_background else None)

    assert saturated_along_stripes(points, [image], 255) is hidden


def test_a_shorter_exposure_is_suggested_only_if_something_is_saturated():
    points, image = faces(0)
    shot = make_shot(image.lit[None], [7], exposure_s=0.008)
    clipped = replace(points, flags=points.flags | int(BreakPointFlag.SATURATED))
    white = replace(image, dark=np.full((120, 250), 255, np.uint8))

    assert not exposure_advice(points, shot, [image])
    assert not exposure_advice(NoBreakPoints.NO_RING, shot, [image])
    assert "4 ms" in exposure_advice(clipped, shot, [image])
    assert "2 ms" in exposure_advice(NoBreakPoints.NO_RING, shot, [white])


def test_an_exposure_of_its_own_is_suggested_for_a_laser_that_is_three_times_fainter():
    points, image = faces(0)
    shot = make_shot(np.stack([image.lit] * 3), [1, 2, 4], exposure_s=0.008)
    clipped = replace(points, flags=points.flags | int(BreakPointFlag.SATURATED))
    frames = [replace(image, lit=np.full_like(image.lit, dn), label=laser) for laser, dn in enumerate((255, 255, 60))]

    assert "4 ms, but laser 3 as now: each for itself" in exposure_advice(clipped, shot, frames)
    assert "laser" not in exposure_advice(clipped, shot, [*frames[:2], replace(frames[2], lit=frames[1].lit)])
