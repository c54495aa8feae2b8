from dataclasses import replace

import numpy as np
import pytest
from drawn_scene import line_of
from scipy.special import ndtr

from ringpose.geometry.rays import intersect, project, rays
from ringpose.simulate.pipeline import illuminated_ring
from ringpose.simulate.renderer import layers, pixel_rays
from ringpose.types.scene import LaserLight, Light
from ringpose.types.target import MATERIALS, Body, Foil, RingShape


def rendered(scene, view):
    return layers(illuminated_ring(scene, view), pixel_rays(scene.rig.camera))


def line_on_face(scene, view, laser):
    """A point and the direction of the line in which a light plane meets the plane of the face."""
    return line_of(scene.rig, laser, view.normal, float(view.normal @ view.center_m))


def stripe_pixels(scene, view, laser):
    """Pixels of the stripe's centre line on the face: projections of dense points of face and light plane."""
    start, along = line_on_face(scene, view, laser)
    pixels = project(start + np.linspace(-0.6, 0.6, 40001)[:, None] * along, scene.rig.camera)
    kept = pixels[np.isfinite(pixels).all(axis=1) & (pixels[:, 0] > -50) & (pixels[:, 0] < 400)]
    return kept[np.argsort(kept[:, 0])]


WIDE_RING = RingShape(profile_m=np.array([[0.2, 0.06], [1.0, 0.06]]), face=MATERIALS["matt"])
"""A flat ring wider than the picture."""


def with_sigma(scene, sigma_m):
    return replace(scene, ring=WIDE_RING, lasers=LaserLight(sigma_m=sigma_m, divergence_rad=0.0))


@pytest.mark.parametrize("sigma_m", [0.0008, 0.0012, 0.0020], ids=["0.6 px", "0.9 px", "1.5 px"])
def test_column_centroids_lie_on_the_analytic_stripe(clean_scene, view, sigma_m):
    flat = with_sigma(clean_scene, sigma_m)

    image = rendered(flat, view).laser[1].astype(float)

    true = stripe_pixels(flat, view, 1)
    columns = np.arange(10, 310)
    centroid = (image * np.arange(240)[:, None]).sum(axis=0)[columns] / image.sum(axis=0)[columns]
    error_px = centroid - np.interp(columns, true[:, 0], true[:, 1])
    assert np.abs(error_px).max() < 0.005


def test_column_centroids_of_a_bent_sheet_lie_on_its_rays(clean_scene, view):
    """The middle of each column's light is where rays that rise with the square of their angle meet the face."""
    flat, bow = with_sigma(clean_scene, 0.0012), 0.05
    bent = replace(flat, lasers=replace(flat.lasers, bow_per_rad=bow))
    projector_m, (normal, axis) = flat.rig.lasers.projector_m[1], np.eye(3)[[1, 2]]
    aside, angle = np.cross(normal, axis), np.linspace(-0.6, 0.6, 20001)[:, None]
    ray = np.cos(bow * angle**2) * (np.cos(angle) * axis + np.sin(angle) * aside) + np.sin(bow * angle**2) * normal
    points = projector_m + ray * (((view.center_m - projector_m) @ view.normal) / (ray @ view.normal))[:, None]
    true = project(points, flat.rig.camera)

    image = rendered(bent, view).laser[1].astype(float)

    columns = np.arange(10, 310)
    centroid = (image * np.arange(240)[:, None]).sum(axis=0)[columns] / image.sum(axis=0)[columns]
    kept = true[np.isfinite(true).all(axis=1) & (true[:, 0] > -20) & (true[:, 0] < 340)]
    kept = kept[np.argsort(kept[:, 0])]
    expected = np.interp(columns, kept[:, 0], kept[:, 1])
    assert np.abs(centroid - expected).max() < 0.01
    assert np.ptp(expected - stripe_pixels_row(flat, view, columns)) > 1.0


def stripe_pixels_row(scene, view, columns):
    true = stripe_pixels(scene, view, 1)
    return np.interp(columns, true[:, 0], true[:, 1])


def test_a_stripe_thinner_than_a_pixel_is_integrated_over_the_pixel(clean_scene, view):
    """Compares the shares of a column's light in its pixels with the integral of a Gaussian over them."""
    flat, sigma_m = with_sigma(clean_scene, 0.0004), 0.0004
    camera, planes = flat.rig.camera, flat.rig.lasers

    column = rendered(flat, view).laser[1][:, 150].astype(float)

    borders = np.stack([np.full(241, 150.0), np.arange(241) - 0.5], axis=1)
    points = intersect(rays(borders, camera), view.normal, np.array(view.normal @ view.center_m))
    shares = np.diff(ndtr((points @ planes.normal[1] - planes.distance_m[1]) / sigma_m))
    np.testing.assert_allclose(column / column.sum(), np.abs(shares), atol=1e-3)


@pytest.mark.parametrize("shift_m", [0.0, 0.004, 0.008, 0.012, 0.016, 0.020])
def test_the_stripe_on_the_face_ends_at_the_break_points(clean_scene, view, shift_m):
    """The light beyond the middle column, in units of the light of a column, is the distance to the end."""
    dark = replace(MATERIALS["black"], diffuse=0.0)
    alone = replace(clean_scene, body=Body(size_m=np.array([2.2, 2.2, 1.0]), material=dark))
    alone = replace(alone, ring=replace(alone.ring, wall=dark))
    moved = replace(view, center_m=view.center_m + np.array([shift_m, 0.0, 0.0]))

    profile = rendered(alone, moved).laser[1].astype(float).sum(axis=0)

    left, right = sorted(stripe_edge(alone, moved, radius_m) for radius_m in (0.567, 0.597))
    columns = np.arange(320)
    inside = (columns > left + 2) & (columns < right - 2)
    share = profile / np.polyval(np.polyfit(columns[inside], profile[inside], 2), columns)
    middle = int((left + right) / 2)
    found = (middle + 0.5 - share[middle - 30 : middle + 1].sum(), middle + 0.5 + share[middle + 1 : middle + 30].sum())
    np.testing.assert_allclose(found, (left, right), atol=0.01)


def stripe_edge(scene, view, radius_m):
    start, along = line_on_face(scene, view, 1)
    off = start - view.center_m
    half = np.sqrt((off @ along) ** 2 - off @ off + radius_m**2)
    ends = [start + (sign * half - off @ along) * along for sign in (-1, 1)]
    return float(project(min(ends, key=lambda p: abs(p[0]))[None], scene.rig.camera)[0, 0])


def test_the_ring_casts_a_shadow_in_laser_light(clean_scene, view):
    """The ring hides a strip of the body from the middle laser, which is 70 mm aside, but not from the camera."""
    lasers = clean_scene.rig.lasers
    offset = replace(lasers, projector_m=lasers.projector_m - [0.3, 0.0, 0.0])
    from_inside = replace(clean_scene, rig=replace(clean_scene.rig, lasers=offset))

    image = rendered(from_inside, view).laser[1]

    edge = max(stripe_edge(clean_scene, view, radius_m) for radius_m in (0.567, 0.597))
    beyond = image[:, int(edge) + 2 : int(edge) + 12].sum(axis=0)
    far_beyond = image[:, int(edge) + 60 : int(edge) + 80].sum(axis=0)
    assert beyond.max() == 0.0
    assert far_beyond.min() > 0.0


def test_foil_deforms_the_stripe(clean_scene, view):
    crinkled = replace(clean_scene, ring=clean_scene.ring, body=Body(size_m=np.array([2.2, 2.2, 1.0]), foil=Foil()))

    flat, wavy = (rendered(scene, view).laser[1].astype(float) for scene in (clean_scene, crinkled))

    def wiggle_px(image):
        columns = np.flatnonzero(image[:, :100].sum(axis=0) > 0)
        rows = np.arange(240)[:, None]
        centroid = (image[:, columns] * rows).sum(axis=0) / image[:, columns].sum(axis=0)
        return (centroid - np.polyval(np.polyfit(columns, centroid, 2), columns)).std()

    assert wiggle_px(flat) < 0.02
    assert wiggle_px(wavy) > 0.05


@pytest.mark.parametrize(("light", "lit"), [("normal", 0.9), ("strong", 0.9), ("dim", 0)])
def test_only_ambient_light_illuminates_the_body_beside_the_stripes(clean_scene, view, light, lit):
    radiance = rendered(clean_scene, replace(view, light=light))
    empty = rendered(clean_scene, replace(view, light=light, target="none"))

    assert (radiance.ambient > 0).mean() > lit if lit else radiance.ambient.max() == 0.0
    assert (radiance.laser.sum(axis=0) > 0).mean() < 0.2
    assert empty.ambient.max() == empty.laser.max() == 0.0


def test_the_sun_casts_the_rings_shadow(clean_scene, view):
    """With a low sun, the body behind the wall of the ring is darker than the body far from it."""
    low = Light(name="low", sun_w_m2=15.0, sun_direction=np.array([-0.9, 0.0, -0.4]))
    matt = replace(
        clean_scene, lights={"dim": low}, body=Body(size_m=np.array([2.2, 2.2, 1.0]), material=MATERIALS["matt"])
    )

    image = rendered(matt, view).ambient

    edge = int(max(stripe_edge(clean_scene, view, radius_m) for radius_m in (0.567, 0.597)))
    row = int(stripe_pixels(clean_scene, view, 1)[:, 1].mean())
    assert image[row, edge + 5] == 0.0
    assert image[row, 300] > 0.0
