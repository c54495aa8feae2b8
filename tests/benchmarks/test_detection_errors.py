"""What is said of break points and centres that are off by known amounts."""

import math
from dataclasses import replace

import numpy as np
import pytest
from benchmarks.detection_errors import (
    break_point_errors,
    center_errors,
    column_bound_px,
    end_bound_px,
)
from benchmarks.robust_statistics import joined
from benchmarks.stripe_images import Kind, exact_break_points, stripe_image, stripe_rig, true_row

from ringpose.types.detection import UNLABELLED, BreakPointFlag, Detection, NoBreakPoints, Stripes


@pytest.fixture(scope="module")
def image():
    return stripe_image(Kind.DARK, 0, stripe_rig(0.4))


@pytest.fixture(scope="module")
def outwards(image):
    """Laser, edge, xy: unit vectors along the stripe, off the face."""
    inwards = image.break_points_px[:, 0] - image.break_points_px[:, 1]
    inwards /= np.linalg.norm(inwards, axis=-1, keepdims=True)
    return np.stack([inwards, -inwards], axis=1)


def detection(points):
    return Detection(shot="a", stamp_s=0.0, break_points=points)


def moved(image, off_px, **changes):
    points = exact_break_points(image)
    return detection(replace(points, position_px=points.position_px + off_px, **changes))


def test_a_break_point_beyond_the_face_is_off_along_the_stripe(image, outwards):
    errors = break_point_errors(moved(image, 0.1 * outwards), image)

    assert errors.along_px == pytest.approx(np.full(6, 0.1), abs=1e-9)
    assert errors.across_px == pytest.approx(np.zeros(6), abs=1e-9)


def test_a_break_point_beside_the_stripe_is_off_across_it(image, outwards):
    errors = break_point_errors(moved(image, 0.1 * outwards[..., ::-1] * [-1, 1]), image)

    assert errors.along_px == pytest.approx(np.zeros(6), abs=1e-9)
    assert abs(errors.across_px) == pytest.approx(np.full(6, 0.1), abs=1e-9)


def test_errors_are_measured_in_the_sigmas_of_their_direction(image, outwards):
    across = outwards[..., ::-1] * [-1, 1]
    covariance = (
        0.2**2 * outwards[..., None] * outwards[..., None, :] + 0.05**2 * across[..., None] * across[..., None, :]
    )

    errors = break_point_errors(moved(image, 0.4 * outwards + 0.05 * across, covariance_px2=covariance), image)

    assert errors.along_sigma_px == pytest.approx(np.full(6, 0.2))
    assert errors.across_sigma_px == pytest.approx(np.full(6, 0.05))
    assert errors.nees == pytest.approx(np.full(6, (2**2 + 1**2) / 2))


def test_a_break_point_that_was_not_seen_is_missing(image):
    position = np.array(image.break_points_px)
    position[1, 0] = np.nan

    errors = break_point_errors(detection(replace(exact_break_points(image), position_px=position)), image)

    assert (len(errors.along_px), errors.expected) == (5, 6)


def test_a_shot_without_break_points_is_missing_all(image):
    errors = break_point_errors(detection(NoBreakPoints.NO_RING), image)

    assert (len(errors.along_px), errors.expected) == (0, 6)


def test_flags_are_told(image):
    flags = np.zeros((3, 2), np.int64)
    flags[2, 1] = BreakPointFlag.KINK

    errors = break_point_errors(moved(image, 0.0, flags=flags), image)

    assert errors.flags.tolist() == [0] * 5 + [BreakPointFlag.KINK]


def test_each_end_has_the_bound_of_its_own_stripe(image):
    errors = break_point_errors(moved(image, 0.0), image)

    bounds = [end_bound_px(float(peak), image.stripe_sigma_px) for peak in image.peak_dn]
    assert errors.bound_px.tolist() == np.repeat(bounds, 2).tolist()


def test_images_add_up(image, outwards):
    parts = [
        break_point_errors(each, image) for each in (moved(image, 0.1 * outwards), detection(NoBreakPoints.NO_RING))
    ]

    both = joined(parts)

    assert (both.expected, len(both.along_px), len(both.nees)) == (12, 6, 6)


def centers(image, *pieces, off_px=0.0, slope=0.0):
    """A centre in each column of the pieces, off the true row; `slope` turns them about their middle."""
    parts = []
    for piece in pieces:
        x = np.arange(*np.rint(image.pieces_px[piece][:, 0]))
        parts.append(np.column_stack([x, true_row(image, piece, x) + off_px + slope * (x - x.mean())]))
    position = np.concatenate(parts)
    return Stripes(
        position_px=position,
        sigma_px=np.full(len(position), 0.1),
        peak_dn=np.full(len(position), 100.0),
        piece=np.repeat(np.arange(len(parts)), [len(part) for part in parts]),
        laser=np.full(len(parts), UNLABELLED),
    )


def test_centers_are_off_by_what_they_are_off(image):
    errors = center_errors(centers(image, 0, 8, off_px=0.3), image)

    assert errors.error_px == pytest.approx(np.full(len(errors.error_px), 0.3), abs=1e-9)
    assert set(errors.bound_px) == {
        column_bound_px(float(image.peak_dn[laser]), image.stripe_sigma_px) for laser in (0, 2)
    }


def test_the_ends_of_a_piece_are_left_out(image):
    start, end = image.pieces_px[0][:, 0]

    errors = center_errors(centers(image, 0), image)

    assert len(errors.error_px) == pytest.approx(end - start - 8, abs=1.5)


@pytest.mark.parametrize("stranger", [{"off_px": 5.0}, {"slope": 0.5}], ids=["beside", "crossing"])
def test_ridges_that_are_no_stripe_have_no_error(image, stranger):
    assert len(center_errors(centers(image, 0, **stranger), image).error_px) == 0


def test_centers_of_images_add_up(image):
    part = center_errors(centers(image, 2), image)

    assert len(joined([part, part]).error_px) == 2 * len(part.error_px)


FAINT_DN, READ_NOISE_DN = 1e-4, 1.5
BRIGHT_DN, ELECTRONS_A_DN = 1e9, 20.0


@pytest.mark.parametrize("sigma_px", [1.5, 2.5, 4.0])
def test_a_faint_column_is_bounded_by_white_noise(sigma_px):
    bound = READ_NOISE_DN / FAINT_DN * math.sqrt(2 * sigma_px / math.sqrt(math.pi))

    assert column_bound_px(FAINT_DN, sigma_px) == pytest.approx(bound, rel=1e-3)


@pytest.mark.parametrize("sigma_px", [1.5, 2.5, 4.0])
def test_a_bright_column_is_bounded_by_the_number_of_its_electrons(sigma_px):
    electrons = ELECTRONS_A_DN * BRIGHT_DN * sigma_px * math.sqrt(2 * math.pi)

    assert column_bound_px(BRIGHT_DN, sigma_px) == pytest.approx(sigma_px / math.sqrt(electrons), rel=1e-3)


@pytest.mark.parametrize("sigma_px", [1.5, 2.5, 4.0])
def test_a_faint_end_is_bounded_by_white_noise(sigma_px):
    bound = READ_NOISE_DN / FAINT_DN * math.sqrt(2 / sigma_px)

    assert end_bound_px(FAINT_DN, sigma_px) == pytest.approx(bound, rel=1e-3)


@pytest.mark.parametrize("bound", [column_bound_px, end_bound_px])
def test_more_light_is_a_lower_bound(bound):
    assert bound(200.0, 2.5) < bound(40.0, 2.5)
