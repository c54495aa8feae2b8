"""The synthetic images show what their truth says."""

import numpy as np
import pytest
from benchmarks.stripe_images import (
    BODY_BEHIND_M,
    RADII_M,
    Kind,
    stripe_image,
    stripe_rig,
    switched_frames,
    true_row,
)

SMALL = stripe_rig(0.5)


@pytest.fixture(scope="module")
def dark():
    return stripe_image(Kind.DARK, 1)


def points_m(image, pixels, laser):
    """Where the rays through (distorted) pixels meet a light plane; distortion undone by iteration."""
    camera, lasers = image.rig.camera, image.rig.lasers
    seen = (pixels - camera.camera_matrix[:2, 2]) / camera.camera_matrix[[0, 1], [0, 1]]
    k1, k2 = camera.distortion_coefficients[:2]
    straight = seen
    for _ in range(50):
        r2 = (straight**2).sum(axis=-1, keepdims=True)
        straight = seen / (1 + k1 * r2 + k2 * r2**2)
    rays = np.concatenate([straight, np.ones((*straight.shape[:-1], 1))], axis=-1)
    return rays * (lasers.distance_m[laser] / (rays @ lasers.normal[laser]))[..., None]


def ring_points_m(image):
    """Laser, edge, xyz."""
    return np.stack([points_m(image, image.break_points_px[laser], laser) for laser in range(3)])


def circumradius(a, b, c):
    sides = [np.linalg.norm(a - b), np.linalg.norm(b - c), np.linalg.norm(c - a)]
    return np.prod(sides) / (2 * np.linalg.norm(np.cross(b - a, c - a)))


@pytest.mark.parametrize("edge", [0, 1])
def test_break_points_lie_on_circles_of_the_rings_radii(dark, edge):
    points = ring_points_m(dark)[:, edge]

    assert circumradius(*points) == pytest.approx(RADII_M[edge], abs=1e-6)


def test_the_body_is_behind_the_rings_plane(dark):
    ring = ring_points_m(dark).reshape(-1, 3)
    normal = np.cross(ring[2] - ring[0], ring[5] - ring[0])
    normal *= np.sign(normal[2]) / np.linalg.norm(normal)
    body = points_m(dark, dark.pieces_px[[0, 2]].reshape(-1, 2), 0)

    assert (ring - ring[0]) @ normal == pytest.approx(np.zeros(6), abs=1e-7)
    assert (body - ring[0]) @ normal == pytest.approx(np.full(4, BODY_BEHIND_M), abs=1e-5)


def column_sums(image, piece, x):
    """Grey values about the true row of each column."""
    rows = np.rint(true_row(image, piece, x)).astype(int) + np.arange(-12, 13)[:, None]
    return image.image[rows, x.astype(int)].astype(np.float64)


@pytest.mark.parametrize("piece", [0, 2, 4, 8])
def test_the_stripe_runs_along_the_true_rows(dark, piece):
    start, end = dark.pieces_px[piece][:, 0]
    x = np.arange(np.ceil(start) + 5, np.floor(end) - 4)
    section = np.maximum(column_sums(dark, piece, x) - 5, 0)
    rows = np.rint(true_row(dark, piece, x)) + (section * np.arange(-12, 13)[:, None]).sum(axis=0) / section.sum(axis=0)

    assert (rows - true_row(dark, piece, x)).mean() == pytest.approx(0, abs=4 * 0.1 / np.sqrt(len(x)))


@pytest.mark.parametrize("laser", [0, 1, 2])
@pytest.mark.parametrize("edge", [0, 1])
def test_at_the_break_point_half_of_the_light_is_left(dark, laser, edge):
    x_break = dark.break_points_px[laser, edge, 0]
    inside = -1 if edge == 0 else 1
    x = np.floor(x_break) + np.arange(-5, 7)
    light = column_sums(dark, 3 * laser + 1, x).sum(axis=0)
    whole = column_sums(dark, 3 * laser + 1, x_break // 1 + inside * np.arange(8.0, 16.0)).sum(axis=0).mean()

    assert np.interp(x_break, x, light) / whole == pytest.approx(0.5, abs=0.08)


def test_speckle_has_a_contrast_of_a_quarter():
    image = stripe_image(Kind.SPECKLE, 1)
    x = np.arange(20.0, image.pieces_px[0, 1, 0] - 10)
    row = true_row(image, 0, x)
    mean = image.peak_dn[0] * np.exp(-0.5 * ((np.rint(row) - row) / image.stripe_sigma_px) ** 2)
    factor = image.image[np.rint(row).astype(int), x.astype(int)] / mean

    assert factor.mean() == pytest.approx(1, abs=0.1)
    assert factor.std() == pytest.approx(0.25, abs=0.06)


def test_a_seed_is_the_same_ring_under_every_kind():
    truths = [stripe_image(kind, 2, SMALL).pieces_px.tolist() for kind in (Kind.DARK, Kind.SATURATED)]

    assert truths[0] == truths[1]
    assert truths[0] != stripe_image(Kind.DARK, 3, SMALL).pieces_px.tolist()


@pytest.mark.parametrize(
    ("kind", "lowest", "highest"),
    [(Kind.DARK, 130, 230), (Kind.DIM, 30, 65), (Kind.SATURATED, 255, 255)],
)
def test_kinds_are_as_bright_as_they_say(kind, lowest, highest):
    assert lowest <= stripe_image(kind, 4, SMALL).image.max() <= highest


def test_foil_has_its_mean():
    without_lasers = switched_frames(Kind.FOIL, 4, SMALL)[1][1]

    assert without_lasers.mean() == pytest.approx(32, rel=0.1)


def test_switched_frames_show_each_laser_alone_and_none():
    image, frames = switched_frames(Kind.DARK, 5, SMALL)
    middle = [image.pieces_px[3 * laser + 2].mean(axis=0).astype(int) for laser in range(3)]

    lit = [[int(frame[y - 3 : y + 4, x].max() > 60) for x, y in middle] for frame in frames]

    assert lit == [[1, 1, 1], [0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]]
    assert (frames[0] == image.image).all()


def test_without_a_lens_pieces_are_straight():
    image = stripe_image(Kind.DARK, 6, stripe_rig(0.5, lens=False))
    start, end = image.pieces_px[2]
    x = np.linspace(start[0], end[0], 7)

    rows = true_row(image, 2, x)

    assert image.image.shape == (600, 800)
    assert rows == pytest.approx(np.interp(x, [start[0], end[0]], [start[1], end[1]]), abs=1e-9)
