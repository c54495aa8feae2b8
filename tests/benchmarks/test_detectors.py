"""The images with truth, and the errors that are measured on them."""

import math
from dataclasses import replace

import numpy as np
import pytest
from benchmarks.compare_detectors import compare, peak_memory_mb, stripe_errors, table
from benchmarks.detection_errors import break_point_errors, center_errors, column_bound_px, end_bound_px
from benchmarks.limits import Figure, status
from benchmarks.opencv_detectors import GIVES_CENTERS, DetectorName, detector
from benchmarks.stripe_images import RADII_M, Kind, exact_break_points, stripe_image, stripe_rig, true_row
from scipy.special import ndtr

from ringpose.measure.stream import estimate_pose
from ringpose.types.detection import UNLABELLED, Detection, NoBreakPoints, Segments, Stripes
from ringpose.types.options import Method


@pytest.fixture(scope="module")
def dark():
    return stripe_image(Kind.DARK, 1)


def test_exact_break_points_give_the_radii_of_the_ring(dark):
    pose = estimate_pose(exact_break_points(dark), dark.rig, Method.PAPER_CONSTRAINED)

    assert (pose.radius_inner_m, pose.radius_outer_m) == pytest.approx(RADII_M, abs=1e-5)


def light_about(image, piece, x):
    """Grey values about the true row of each column."""
    rows = np.rint(true_row(image, piece, x)).astype(int) + np.arange(-12, 13)[:, None]
    return image.image[rows, x.astype(int)].astype(np.float64)


@pytest.mark.parametrize("piece", [0, 2, 4, 8])
def test_the_stripe_runs_along_the_true_rows(dark, piece):
    start, end = dark.pieces_px[piece][:, 0]
    x = np.arange(np.ceil(start) + 5, np.floor(end) - 4)
    light = np.maximum(light_about(dark, piece, x) - 5, 0)
    rows = np.rint(true_row(dark, piece, x)) + (light * np.arange(-12, 13)[:, None]).sum(axis=0) / light.sum(axis=0)

    assert (rows - true_row(dark, piece, x)).mean() == pytest.approx(0, abs=4 * 0.1 / np.sqrt(len(x)))


@pytest.mark.parametrize("laser", [0, 1, 2])
@pytest.mark.parametrize("edge", [0, 1])
def test_at_the_break_point_half_of_the_light_is_left(dark, laser, edge):
    x_break = dark.break_points_px[laser, edge, 0]
    x = np.floor(x_break) + np.arange(-5, 7)
    light = light_about(dark, 3 * laser + 1, x).sum(axis=0)
    inside = x_break // 1 + (-1 if edge == 0 else 1) * np.arange(8.0, 16.0)
    whole = light_about(dark, 3 * laser + 1, inside).sum(axis=0).mean()

    assert np.interp(x_break, x, light) / whole == pytest.approx(0.5, abs=0.08)


def test_break_points_are_off_along_and_across_the_stripe_in_their_own_sigmas(dark):
    along = dark.break_points_px[:, 0] - dark.break_points_px[:, 1]
    along /= np.linalg.norm(along, axis=-1, keepdims=True)
    outwards = np.stack([along, -along], axis=1)
    across = outwards[..., ::-1] * [-1, 1]
    covariance = sum(s**2 * axis[..., None] * axis[..., None, :] for s, axis in ((0.2, outwards), (0.05, across)))
    exact = exact_break_points(dark)
    off = replace(exact, position_px=exact.position_px + 0.4 * outwards + 0.05 * across, covariance_px2=covariance)

    errors = break_point_errors(Detection(shot="a", stamp_s=0.0, break_points=off), dark)

    assert errors.along_px == pytest.approx(np.full(6, 0.4), abs=1e-9)
    assert np.abs(errors.across_px) == pytest.approx(np.full(6, 0.05), abs=1e-9)
    assert errors.along_sigma_px == pytest.approx(np.full(6, 0.2))
    assert errors.nees == pytest.approx(np.full(6, (2**2 + 1**2) / 2))
    none = break_point_errors(Detection(shot="a", stamp_s=0.0, break_points=NoBreakPoints.NO_RING), dark)
    assert (len(none.along_px), none.expected) == (0, 6)


@pytest.mark.parametrize(("off_px", "slope", "counted"), [(0.3, 0.0, True), (5.0, 0.0, False), (0.0, 0.5, False)])
def test_centers_are_off_by_what_they_are_off_unless_they_only_cross_the_stripe(dark, off_px, slope, counted):
    x = np.arange(*np.rint(dark.pieces_px[0][:, 0]))
    position_px = np.column_stack([x, true_row(dark, 0, x) + off_px + slope * (x - x.mean())])
    stripes = Stripes(
        position_px=position_px, sigma_px=np.full(len(x), 0.1), peak_dn=np.full(len(x), 100.0),
        piece=np.zeros(len(x), dtype=np.int64), laser=np.array([UNLABELLED]),
    )  # fmt: skip

    found = center_errors(stripes, dark).error_px

    assert (len(found) > 0) == counted
    assert found == pytest.approx(np.full(len(found), off_px), abs=1e-9)


@pytest.mark.parametrize("sigma_px", [1.5, 4.0])
def test_bounds_are_those_of_white_noise_and_of_the_number_of_electrons(sigma_px):
    faint_dn, read_noise_dn, bright_dn, electrons_per_dn = 1e-4, 1.5, 1e9, 20.0

    faint = read_noise_dn / faint_dn * math.sqrt(2 * sigma_px / math.sqrt(math.pi))
    bright = sigma_px / math.sqrt(electrons_per_dn * bright_dn * sigma_px * math.sqrt(2 * math.pi))
    faint_end = read_noise_dn / faint_dn * math.sqrt(2 / sigma_px)

    found = column_bound_px(faint_dn, sigma_px), column_bound_px(bright_dn, sigma_px), end_bound_px(faint_dn, sigma_px)
    assert found == pytest.approx((faint, bright, faint_end), rel=1e-3)


SLACK_PX = {DetectorName.LSD: 0.05, DetectorName.REFINED: 0.05, DetectorName.LENGTH: 1.5, DetectorName.HOUGH: 1.0}
"""What a chord of whole pixels, or votes for whole pixels, may be off by; the others fit lines."""


@pytest.mark.parametrize("normal", [(0.03, 1.0), (1.0, -0.04)], ids=["along rows", "along columns"])
@pytest.mark.parametrize("name", [name for name in DetectorName if name not in GIVES_CENTERS])
def test_every_detector_finds_a_blurred_edge_where_it_is(name, normal):
    def distance_px(points):
        return (points - np.array([120.3, 90.2])) @ (normal / np.hypot(*normal))

    row, column = np.mgrid[0:180, 0:240].astype(np.float64)
    image = np.rint(40 + 120 * ndtr(distance_px(np.stack([column, row], axis=-1)))).astype(np.uint8)

    segments = detector(name)(image)

    length = np.hypot(*(segments.end_px - segments.start_px).T)
    middle = (segments.start_px + segments.end_px)[np.argmax(length)] / 2
    assert length.max() > (25 if name == DetectorName.HOUGH else 100)
    assert abs(distance_px(middle)) < SLACK_PX.get(name, 0.35)
    assert len(detector(name)(np.zeros((5, 50), np.uint8)).support) == 0


def test_segments_that_are_off_and_short_by_known_amounts_have_these_errors():
    image = stripe_image(Kind.DARK, 1, stripe_rig(lens=False))
    sigma = image.stripe_sigma_px
    slope = np.diff(image.pieces_px[..., 1]) / np.diff(image.pieces_px[..., 0])
    inwards = np.stack([np.hstack([np.ones_like(slope), slope]), -np.hstack([np.ones_like(slope), slope])], axis=1)
    lines = image.pieces_px + 1.5 * inwards
    upper, lower = np.array([0.0, 0.4 - sigma]), np.array([0.0, sigma])  # one edge is off by 0.4 px
    ends = np.concatenate([lines + upper, lines[:, ::-1] + lower, [[[30.0, 5.0], [80.0, 5.0]]]])

    errors = stripe_errors(
        Segments(start_px=ends[:, 0], end_px=ends[:, 1], support=np.ones(len(ends), np.int64)), image, centers=False
    )

    assert errors["center_px"] == pytest.approx(np.full(len(errors["center_px"]), 0.2), abs=1e-9)
    assert errors["short_px"] == pytest.approx(np.full(18, 1.5), abs=1e-9)
    assert errors["pieces"].tolist() == [1.0] * 9
    assert errors["coverage"].min() > 0.8
    assert errors["false"].tolist() == [1.0]


@pytest.mark.slow
def test_the_table_has_every_detector_and_the_chain():
    lines = table("dark", compare([stripe_image(Kind.DARK, 0, stripe_rig(lens=False))], rounds=1)).splitlines()

    first_columns = lines[2 : lines.index("")]  # the others continue below
    assert [line.split("  ")[0] for line in first_columns] == [*map(str, DetectorName), "ringpose detect"]


@pytest.mark.parametrize(
    ("measured", "limits", "is_kept"),
    [
        (0.1, {"max_value": 0.2}, True),
        (math.nan, {"max_value": 0.2}, False),
        (2.0, {"min_value": 0.8, "max_value": 1.25}, False),
        (0.7, {"min_value": 0.8}, False),
        (7.0, {}, True),
    ],
)
def test_a_figure_beyond_a_limit_or_not_measured_is_status_3(capsys, measured, limits, is_kept):
    assert status([Figure(name="a", measured=measured, **limits)]) == (0 if is_kept else 3)
    assert ("MISSED" in capsys.readouterr().out) is not is_kept


def test_the_memory_of_a_detector_is_that_of_its_copies_of_the_image(dark):
    megabytes = peak_memory_mb(DetectorName.LSD, dark.image)

    assert 8 * 0.64 * dark.image.size / 2**20 < megabytes < 200  # it scales the image to 0.8, in doubles
