"""The ring's visible edges, in pictures drawn from formulas and on a rendered shot."""

import json
from dataclasses import replace

import cv2
import numpy as np
import pytest
from drawn_edges import (
    Surroundings,
    all_radii_m,
    lit,
    measured,
    narrow,
    off_edge_px,
    picture,
    radius_m,
)
from drawn_scene import RADII_M, DrawnScene, drawn_rig, exposed, light, noise
from ring_scenes import with_stripes
from true_edges import edge_errors_px

from ringpose.detect import ring_edges
from ringpose.detect.edge_search import EdgeImage, ring_from_stripes
from ringpose.detect.pipeline import detect
from ringpose.detect.ring_edges import (
    FoundEdges,
    detect_ring_edges,
    found_edges,
    named_by_curvature,
    uncertainty_factor,
)
from ringpose.estimate.pose_errors import mahalanobis_squared
from ringpose.files.images.shots import read_shot
from ringpose.files.rigs import read_rig
from ringpose.measure.stream import Setup
from ringpose.types.assumptions import IDEAL
from ringpose.types.detection import BreakPointFlag, BreakPoints, RingEdgePoints, Stripes
from ringpose.types.image import Shot
from ringpose.types.pose import PoseFlag
from ringpose.types.rig import Rig


@pytest.fixture(scope="module")
def rig() -> Rig:
    """The drawn scenes' rig with a lens that does not distort, so that every pixel's ray is a formula."""
    drawn = drawn_rig()
    camera = replace(drawn.camera, distortion_coefficients=np.zeros(5))
    return replace(drawn, camera=camera)


def seen_edges(ends: BreakPoints, frame: EdgeImage, rig: Rig) -> RingEdgePoints:
    found = found_edges(ends, frame, rig)
    assert found is not None
    return found.points


@pytest.mark.parametrize("lasers", ["wide", "narrow"])
@pytest.mark.parametrize("depth_m", [0.3, 0.5, 1.0])
def test_points_lie_on_the_true_edges_within_a_twentieth_of_a_pixel(rig, rng, lasers, depth_m):
    rig = rig if lasers == "wide" else narrow(rig)
    scene = DrawnScene(center_m=(0.58, 0.02, depth_m))

    points = seen_edges(measured(scene, rig, rng), lit(picture(scene, rig, Surroundings(), rng)), rig)

    error_px = off_edge_px(points, scene, rig)
    assert abs(np.median(error_px)) < 0.025
    assert 1.4826 * np.median(np.abs(error_px)) < 0.05


@pytest.mark.parametrize("lasers", ["wide", "narrow"])
def test_both_edges_are_followed_through_the_whole_image(rig, rng, lasers):
    rig = rig if lasers == "wide" else narrow(rig)
    scene = DrawnScene()

    points = seen_edges(measured(scene, rig, rng), lit(picture(scene, rig, Surroundings(), rng)), rig)

    rows = [points.position_px[points.edge == edge, 1] for edge in (0, 1)]
    assert all(each.min() < 25 and each.max() > 1175 for each in rows)


@pytest.mark.parametrize("clutter_dn", [0.0, 15.0, 40.0])
def test_sigmas_explain_the_errors_beside_clutter(rig, rng, clutter_dn):
    scene = DrawnScene()
    around = Surroundings(outside_dn=80.0, clutter_dn=clutter_dn)

    points = seen_edges(measured(scene, rig, rng), lit(picture(scene, rig, around, rng)), rig)

    squares = (off_edge_px(points, scene, rig) / points.sigma_px) ** 2
    assert 0.4 < np.mean(squares) < 1.5
    assert np.max(squares) < 25


def test_sigmas_explain_the_errors_beside_foil_as_bright_as_the_face(rig, rng):
    """The edges do not show in a quarter of such pictures."""
    scene = DrawnScene()
    around = Surroundings(inside_dn=45.0, outside_dn=45.0, clutter_dn=15.0, noise_dn=0.0)
    squares = []
    for _ in range(6):
        highlights = np.maximum(picture(scene, rig, around, rng), around.face_dn).astype(np.float32)
        edges = found_edges(measured(scene, rig, rng), lit(exposed(highlights + noise(highlights.shape, rng))), rig)
        if edges is not None:
            squares.append(np.mean((off_edge_px(edges.points, scene, rig) / edges.points.sigma_px) ** 2))

    assert len(squares) >= 2
    assert max(squares) < 1.0


@pytest.mark.parametrize("blur_px", [0.5, 0.9, 1.5])
def test_blur_of_the_lens_moves_edges_by_less_than_a_twentyfifth_of_a_pixel(rig, rng, blur_px):
    scene = DrawnScene()
    image = picture(scene, rig, Surroundings(blur_px=blur_px), rng)

    points = seen_edges(measured(scene, rig, rng), lit(image), rig)

    assert abs(np.mean(off_edge_px(points, scene, rig))) < 0.04


def test_normals_lead_off_the_face(rig, rng):
    scene = DrawnScene()

    points = seen_edges(measured(scene, rig, rng), lit(picture(scene, rig, Surroundings(), rng)), rig)

    step_m = radius_m(scene, rig, *(points.position_px + points.normal).T) - np.array(RADII_M)[points.edge]
    assert np.all(np.sign(step_m) == np.where(points.edge == 0, -1, 1))
    np.testing.assert_allclose(np.hypot(*points.normal.T), 1.0, atol=1e-12)


@pytest.mark.parametrize(
    ("around", "edge", "most"),
    [(Surroundings(inside_dn=60.0), 0, 0.05), (Surroundings(outside_dn=400.0), 1, 0.0)],
    ids=["without contrast", "saturated beyond it"],
)
def test_an_edge_that_does_not_show_is_absent(rig, rng, around, edge, most):
    scene = DrawnScene()

    points = seen_edges(measured(scene, rig, rng), lit(picture(scene, rig, around, rng)), rig)

    assert np.mean(points.edge == edge) <= most


@pytest.mark.parametrize("level_dn", [2.0, 120.0, 255.0, None], ids=["dark", "grey", "saturated", "noise"])
def test_an_even_image_and_noise_show_no_edges(rig, rng, level_dn):
    scene = DrawnScene()
    if level_dn is None:
        image = rng.integers(0, 256, (1200, 1600)).astype(np.uint8)
    else:
        image = picture(scene, rig, Surroundings(face_dn=level_dn, inside_dn=level_dn, outside_dn=level_dn), rng)

    assert found_edges(measured(scene, rig, rng), lit(image), rig) is None


def test_a_wall_below_the_edge_is_not_taken_for_it(rig, rng):
    scene = DrawnScene()
    wall = replace(scene, center_m=(0.58, 0.02, 0.54))
    image = picture(scene, rig, Surroundings(inside_dn=60.0), rng)
    image[(all_radii_m(wall, rig) < RADII_M[0]) & (all_radii_m(scene, rig) < RADII_M[0])] = 20

    points = seen_edges(measured(scene, rig, rng), lit(image), rig)

    error_px = off_edge_px(points, scene, rig)
    assert np.mean(np.abs(error_px) > 0.5) < 0.02
    assert np.abs(error_px / points.sigma_px).max() < 5


def test_a_bar_across_the_ring_gives_no_points_off_the_edges(rig, rng):
    scene = DrawnScene()
    image = picture(scene, rig, Surroundings(), rng)
    image[650:800] = 90
    image[650:800, ::7] = 20

    points = seen_edges(measured(scene, rig, rng), lit(image), rig)

    assert np.abs(off_edge_px(points, scene, rig) / points.sigma_px).max() < 6
    assert np.count_nonzero((points.position_px[:, 1] > 655) & (points.position_px[:, 1] < 795)) < 3


def test_two_stripes_lead_to_the_edges_too(rig, rng):
    scene = DrawnScene(center_m=(0.58, 0.05, 0.235))
    both = measured(scene, rig, rng)
    in_view = ((both.position_px[..., 1] > 0) & (both.position_px[..., 1] < 1199)).all(axis=1)
    seen = with_stripes(both, *np.flatnonzero(in_view))

    points = seen_edges(seen, lit(picture(scene, rig, Surroundings(), rng)), rig)

    assert np.abs(off_edge_px(points, scene, rig)).max() < 0.3


@pytest.mark.parametrize("laser", [0, 1, 2])
def test_a_single_stripe_leads_to_the_edges_too(rig, rng, laser):
    scene = DrawnScene()
    seen = with_stripes(measured(scene, rig, rng), laser)

    points = seen_edges(seen, lit(picture(scene, rig, Surroundings(), rng)), rig)

    assert np.abs(off_edge_px(points, scene, rig)).max() < 0.3
    assert np.ptp(points.position_px[:, 1]) > 1100


def test_no_stripe_leads_nowhere(rig, rng):
    scene = DrawnScene()
    nothing = replace(measured(scene, rig, rng), position_px=np.full((3, 2, 2), np.nan))

    assert found_edges(nothing, lit(picture(scene, rig, Surroundings(), rng)), rig) is None


def test_images_of_twelve_bits_give_the_same_edges(rig, rng):
    scene = DrawnScene()
    ends = measured(scene, rig, rng)
    image = picture(scene, rig, Surroundings(), rng)

    eight = seen_edges(ends, lit(image), rig)
    twelve = seen_edges(ends, EdgeImage(image=image.astype(np.uint16) * 16, saturation_dn=4095), rig)

    assert abs(len(twelve.edge) - len(eight.edge)) <= 4
    np.testing.assert_allclose(off_edge_px(twelve, scene, rig).std(), off_edge_px(eight, scene, rig).std(), atol=0.01)


def named_wrong(points: BreakPoints) -> BreakPoints:
    return replace(
        points,
        position_px=points.position_px[:, ::-1].copy(),
        flags=np.full((3, 2), int(BreakPointFlag.EDGE_UNKNOWN)),
    )


def test_curvature_tells_on_which_side_the_centre_lies(rig, rng):
    rig, scene = narrow(rig), DrawnScene()
    ends, frame = measured(scene, rig, rng), lit(picture(scene, rig, Surroundings(), rng))

    right, wrong = found_edges(ends, frame, rig), found_edges(named_wrong(ends), frame, rig)

    assert right is not None
    assert wrong is not None
    assert right.side_sigmas > 10 > -10 > wrong.side_sigmas


def test_edges_with_open_names_are_named_by_their_curvature(rig, rng):
    rig, scene = narrow(rig), DrawnScene()
    ends = measured(scene, rig, rng)
    frame = lit(picture(scene, rig, Surroundings(), rng))
    found = found_edges(named_wrong(ends), frame, rig)
    assert found is not None

    named, points = named_by_curvature(named_wrong(ends), [found])

    np.testing.assert_array_equal(named.position_px, ends.position_px)
    assert not np.any(named.flags)
    assert np.abs(off_edge_px(points, scene, rig)).max() < 0.5


def test_a_curvature_without_a_standard_deviation_names_no_edge(rig, rng):
    ends = named_wrong(measured(DrawnScene(), rig, rng))
    point = RingEdgePoints(
        position_px=np.zeros((1, 2)), normal=np.array([[1.0, 0.0]]), sigma_px=np.ones(1), edge=np.zeros(1, np.int64)
    )

    assert named_by_curvature(ends, [FoundEdges(point, np.nan, 1)])[0] is ends


def test_names_that_are_known_stay(rig, rng):
    rig, scene = narrow(rig), DrawnScene()
    ends = replace(named_wrong(measured(scene, rig, rng)), flags=np.zeros((3, 2), dtype=np.int64))
    found = found_edges(ends, lit(picture(scene, rig, Surroundings(), rng)), rig)
    assert found is not None

    assert named_by_curvature(ends, [found])[0] is ends


def test_a_rendered_shot_with_all_lasers_on_shows_its_edges(carried_data):
    rig = read_rig(carried_data / "rig_b" / "rig.yaml")
    lines = (carried_data / "rig_b" / "truth.jsonl").read_text().splitlines()
    truth = next(each for each in map(json.loads, lines) if each["shot"] == "B_z0500_p01_normal")

    detection = detect(read_shot(carried_data / "rig_b" / "shots" / "B_z0500_p01_normal.npz"), rig)

    points = detection.ring_edges
    assert points is not None
    error_px = edge_errors_px(points, truth, rig)
    assert len(error_px) > 100
    assert 1.4826 * np.median(np.abs(error_px)) < 0.3
    assert abs(np.sum(error_px / points.sigma_px**2) / np.sum(points.sigma_px**-2)) < 0.1
    assert 0.6 < np.mean((error_px / points.sigma_px) ** 2) < 1.5


def test_dim_light_shows_no_edges(carried_data):
    rig = read_rig(carried_data / "rig_b" / "rig.yaml")

    detection = detect(read_shot(carried_data / "rig_b" / "shots" / "B_z0500_p00_dim.npz"), rig)

    assert detection.ring_edges is None


def test_contradictory_break_points_give_no_exception(rig, rng):
    frame = lit(picture(DrawnScene(), rig, Surroundings(), rng))
    true = measured(DrawnScene(), rig, rng)
    for_all = rng.uniform(-50, [1650, 1250], (20, 3, 2, 2))

    for_each = [found_edges(replace(true, position_px=position), frame, rig) for position in for_all]

    assert all(found is None or np.isfinite(found.points.position_px).all() for found in for_each)


def lit_shot(scene: DrawnScene, rig: Rig, rng: np.random.Generator, laser: int, along_px: int) -> Shot:
    """The lasers one by one before a lit ring and foil as bright as its face; one stripe displaced along itself."""
    around = Surroundings(inside_dn=58.0, outside_dn=62.0, clutter_dn=12.0)
    off = picture(scene, rig, around, rng).astype(float)
    stripes = [light(scene, rig, each) for each in range(3)]
    stripes[laser] = np.roll(stripes[laser], along_px, axis=1)
    frames = [off, *(off + each for each in stripes)]
    images = np.stack([np.clip(np.rint(each), 0, 255).astype(np.uint8) for each in frames])
    masks = np.array([0, 1, 2, 4], dtype=np.uint8)
    stamp_s, exposure_s = 0.03 * np.arange(4.0), np.full(4, 0.001)
    return Shot(name="lit", images=images, lasers=masks, stamp_s=stamp_s, exposure_s=exposure_s, meta={"still": True})


@pytest.mark.parametrize("along_px", [10, pytest.param(-10, marks=pytest.mark.slow)])
@pytest.mark.parametrize("laser", [pytest.param(0, marks=pytest.mark.slow), 1, pytest.param(2, marks=pytest.mark.slow)])
def test_a_displaced_stripe_does_not_lead_to_edges_of_another_ring(rig, rng, laser, along_px):
    scene = DrawnScene()

    line = Setup(rig=rig).measure(lit_shot(scene, rig, rng, laser, along_px))

    assert line.status == "degraded"
    error_m = line.pose.center_m - np.array(scene.center_m)
    named = line.flags & (PoseFlag.CENTER_WEAK | PoseFlag.INCONSISTENT)
    assert named or mahalanobis_squared(error_m, line.pose.covariance_center_m2) < 16


def with_stripe_of(points: BreakPoints, other: BreakPoints, laser: int) -> BreakPoints:
    """The break points, those of one laser from another measurement."""
    taken = np.arange(len(points.flags)) == laser
    return replace(
        points,
        position_px=np.where(taken[:, None, None], other.position_px, points.position_px),
        face_start_undistorted_px=np.where(
            taken[:, None], other.face_start_undistorted_px, points.face_start_undistorted_px
        ),
        face_end_undistorted_px=np.where(taken[:, None], other.face_end_undistorted_px, points.face_end_undistorted_px),
    )


def edges_in(image: np.ndarray, points: BreakPoints, rig: Rig) -> RingEdgePoints | None:
    """The edges in a frame without lasers."""
    shot = Shot(
        name="off",
        images=image[None],
        lasers=np.zeros(1, dtype=np.uint8),
        stamp_s=np.zeros(1),
        exposure_s=np.full(1, 0.001),
    )
    stripes = Stripes(
        position_px=np.zeros((0, 2)),
        sigma_px=np.zeros(0),
        peak_dn=np.zeros(0),
        piece=np.zeros(0, dtype=np.int64),
        laser=np.zeros(0, dtype=np.int64),
    )
    return detect_ring_edges(points, shot, stripes, rig, IDEAL, camera=None, motion=None).points


@pytest.mark.parametrize("laser", [0, 1, 2])
def test_edges_are_not_searched_without_a_stripe_in_front_of_the_others(rig, rng, monkeypatch, laser):
    """It may be on the face, and the others on a flange behind it, whose edges are visible, too."""
    flange = DrawnScene()
    normal = np.array(flange.normal) / np.linalg.norm(flange.normal)
    face = replace(flange, center_m=tuple(np.array(flange.center_m) + 0.03 * normal))
    points = with_stripe_of(measured(flange, rig, rng), measured(face, rig, rng), laser)
    image = picture(flange, rig, Surroundings(inside_dn=58.0, outside_dn=62.0, clutter_dn=12.0), rng)

    found = edges_in(image, points, rig)

    monkeypatch.setattr(ring_edges, "edges_lit", lambda *_: False)  # then they are searched with all stripes only
    with_all = edges_in(image, points, rig)
    assert (found is None) == (with_all is None)
    assert found is None or np.array_equal(found.position_px, with_all.position_px)


def displaced_along(points: BreakPoints, along_px: float) -> BreakPoints:
    """The break points, all of them displaced along the rows."""
    along = np.array([along_px, 0.0])
    return replace(
        points,
        position_px=points.position_px + along,
        face_start_undistorted_px=points.face_start_undistorted_px + along,
        face_end_undistorted_px=points.face_end_undistorted_px + along,
    )


@pytest.mark.parametrize("along_px", [-12.0, 12.0])
def test_of_two_contradictory_stripes_neither_leads_to_edges(rig, rng, along_px):
    scene = DrawnScene()
    right = measured(scene, rig, rng)
    points = with_stripe_of(right, displaced_along(right, along_px), 2)
    image = picture(scene, rig, Surroundings(inside_dn=58.0, outside_dn=62.0, clutter_dn=12.0), rng)

    assert edges_in(image, with_stripes(right, 0, 2), rig) is not None
    assert edges_in(image, with_stripes(points, 0, 2), rig) is None


@pytest.mark.parametrize("displaced_px", [0.0, 12.0])
def test_edges_found_only_without_a_stripe_are_used_if_they_contradict_it(rig, rng, monkeypatch, displaced_px):
    scene, laser = DrawnScene(), 1
    points = measured(scene, rig, rng)
    seen = seen_edges(points, lit(picture(scene, rig, Surroundings(), rng)), rig)

    def without_laser(given: BreakPoints, *_) -> FoundEdges | None:
        few = FoundEdges(seen, side_sigmas=50.0, steps=60, mostly_visible=False)
        return None if given.of_lasers[laser] else few

    monkeypatch.setattr(ring_edges, "found_edges", without_laser)
    image = picture(scene, rig, Surroundings(), rng)

    given = with_stripe_of(points, displaced_along(points, displaced_px), laser)
    found = edges_in(image, given, rig)

    assert (found is not None) == (displaced_px > 0)


def factor_of(rig: Rig, rng: np.random.Generator, edges: list[int]) -> float:
    """The factor on the standard deviations of the points of these edges, as if few places showed them."""
    scene = DrawnScene()
    break_points, frame = measured(scene, rig, rng), lit(picture(scene, rig, Surroundings(), rng))
    found = found_edges(break_points, frame, rig)
    stripes = ring_from_stripes(break_points, rig)
    of_edges = np.isin(found.points.edge, edges)
    parts = {name: getattr(found.points, name)[of_edges] for name in ("position_px", "normal", "sigma_px", "edge")}
    return uncertainty_factor(RingEdgePoints(**parts), found.arcs, stripes, frame, rig)


def test_points_of_one_edge_are_not_used_if_the_stripes_leave_the_curvature_open(rig, rng):
    assert np.isfinite(factor_of(rig, rng, [1]))
    assert factor_of(narrow(rig), rng, [1]) == np.inf
    assert np.isfinite(factor_of(narrow(rig), rng, [0, 1]))


ON_THE_EDGES = ((80, 200, 1, 0.0), (320, 350, 1, 0.0), (700, 740, 0, 0.0), (880, 1000, 0, 0.0))
BESIDE_ONE_EDGE = ((60, 180, 0, -1.0), (400, 900, 0, 2.0))
MOSTLY_BESIDE = ((85, 185, 0, 3.0), (341, 383, 0, 4.0), (464, 615, 0, 2.0), (722, 854, 0, 2.0), (100, 160, 1, 0.0))


@pytest.mark.parametrize("facets", [ON_THE_EDGES, BESIDE_ONE_EDGE, MOSTLY_BESIDE])
def test_steps_on_a_few_facets_of_foil_as_bright_as_the_face_are_few_coincidences(rig, rng, facets):
    """Bright facets (first and last row, edge, distance beyond it in pixels) are all that shows where the edges are."""
    scene, around = DrawnScene(), Surroundings(inside_dn=60.0, outside_dn=60.0)
    radii_m, row, metres_per_px = all_radii_m(scene, rig), np.arange(1200)[:, None], scene.center_m[2] / 1781.0
    bright = np.zeros(radii_m.shape)
    for first, last, edge, beyond_px in facets:
        off_m = (2 * edge - 1) * (radii_m - RADII_M[edge])
        bright[(off_m > beyond_px * metres_per_px) & (row >= first) & (row < last)] = 40.0
    image = picture(scene, rig, around, rng) + cv2.GaussianBlur(bright, (0, 0), around.blur_px)

    found = found_edges(measured(scene, rig, rng), lit(np.rint(image).astype(np.uint8)), rig)

    curvature = found.arcs.curvature
    assert abs(curvature - 2.0 / sum(RADII_M)) < 3.0 * curvature / found.side_sigmas
