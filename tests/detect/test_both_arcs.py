"""Rings of which both arcs are in view, in rendered images: where the ends are is computed apart from the renderer."""

import functools
from dataclasses import replace

import numpy as np
import pytest
from flat_stripes import height_m, segment_on_plane
from ring_scenes import PROJECTED, Ring, make_camera, pixels_of

from ringpose.detect.pipeline import detect
from ringpose.detect.rim import ring_face
from ringpose.kernels.lines import (
    CENTERS,
    CLIPPED,
    LASER,
    MIDDLE_X,
    MIDDLE_Y,
    SCATTER,
    X_END,
    X_START,
)
from ringpose.measure.stream import Setup
from ringpose.simulate.pipeline import simulate
from ringpose.types.detection import UNLABELLED
from ringpose.types.image import Shot
from ringpose.types.rig import Rig
from ringpose.types.scene import Light, RingView, Scene, Sensor
from ringpose.types.target import Body, RingShape

RIG = Rig(camera=make_camera((800, 600), (889.0, 889.0), (400.0, 300.0)), lasers=PROJECTED)
"""The paper's physical light planes and lens, with pixels of 9 um."""

SWITCHED, TOGETHER = [0, 1, 2, 3], [0, 4]

RADIUS_M = np.array([0.13, 0.15])


@functools.cache
def simulated(y_m: float):
    """A shot of a flange before a flat body, its centre at that height in the image; and the ring."""
    normal = np.array([0.1, 0.05, -0.99])
    ring = Ring(center_m=np.array([0.02, y_m, 0.5]), normal=normal / np.linalg.norm(normal), radius_m=RADIUS_M)
    scene = Scene(
        rig=RIG,
        ring=RingShape(profile_m=np.array([[0.13, 0.0], [0.13, 0.06], [0.15, 0.06], [0.15, 0.0]])),
        body=Body(size_m=np.array([1.0, 1.0, 0.5])),
        lights={"dim": Light(name="dim")},
        sensor=Sensor(pixel_m=9e-6),
        exposure_s=0.001,
        stripe_dn=170.0,
        sequence=(0, 1, 2, 4, 7),
        views=(RingView(name="view", center_m=ring.center_m, normal=ring.normal),),
    )
    shot, _ = next(iter(simulate(scene)))
    return shot, ring


def shot_of(y_m: float, frames: list[int]):
    """Some frames of such a shot, and the ring."""
    shot, ring = simulated(y_m)
    parts = {name: getattr(shot, name)[frames] for name in ("images", "lasers", "stamp_s", "exposure_s")}
    return replace(shot, **parts, device_stamp_s=None, gain_db=None, frame_id=None), ring


@pytest.fixture(scope="module")
def shots():
    """A ring that all stripes cross twice, and one of which the left laser's stripe passes beside the hole."""
    return {y_m: shot_of(y_m, SWITCHED) for y_m in (-0.05, -0.09)}


@pytest.mark.parametrize("frames", [SWITCHED, TOGETHER], ids=["switched", "together"])
def test_ends_on_both_arcs_are_where_the_light_planes_cross_the_ring(frames):
    shot, ring = shot_of(-0.05, frames)
    true_px = pixels_of(ring.crossings_m(RIG.lasers), RIG.camera)  # laser, edge, left or right

    points = detect(shot, RIG).break_points

    sides = [0, 1] if points.position_px[0, 1, 0] < points.opposite.position_px[0, 1, 0] else [1, 0]
    for arc, side in zip(points.arcs, sides, strict=True):
        assert arc.seen.all()
        assert np.abs(arc.position_px - true_px[:, :, side]).max() < 1.0
    assert points.labelled == (frames is SWITCHED)


def test_the_first_arc_is_the_one_nearer_to_the_middle_of_the_image(shots):
    points = detect(shots[-0.05][0], RIG).break_points

    first, opposite = (np.abs(arc.position_px[..., 0] - 400.0).mean() for arc in points.arcs)

    assert first < opposite


def test_a_stripe_beside_the_hole_has_an_outer_end_on_each_arc_and_one_line(shots):
    points = detect(shots[-0.09][0], RIG).break_points

    (beside,) = [laser for laser in range(3) if not (points.seen[laser, 0] or points.opposite.seen[laser, 0])]
    assert points.seen[beside, 1]
    assert points.opposite.seen[beside, 1]
    lines = [np.isfinite(arc.face_start_undistorted_px[beside]).all() for arc in points.arcs]
    assert sorted(lines) == [False, True]


@pytest.mark.parametrize("y_m", [-0.05, -0.09])
def test_the_pose_by_both_arcs_is_within_its_errors_and_more_certain_than_by_one(shots, y_m):
    (shot, ring), setup = shots[y_m], Setup(rig=RIG)
    detection = setup.detection(shot)
    of_one = replace(detection, break_points=replace(detection.break_points, opposite=None), ring=None)

    both, one = (setup.line(each).pose for each in (detection, of_one))

    error_m, covariance = both.center_m - ring.center_m, both.covariance_center_m2
    assert error_m @ np.linalg.solve(covariance, error_m) < 16.3  # one in a thousand
    assert np.linalg.norm(error_m) < 0.3e-3
    assert np.trace(covariance) < np.trace(one.covariance_center_m2)


def test_the_grasp_point_is_on_the_arc_nearer_to_the_place_that_is_asked_for(shots):
    shot, ring = shots[-0.05]
    setups = [Setup(rig=RIG, grasp_near_px=place) for place in (None, (0.0, 300.0), (799.0, 300.0))]

    usual, left, right = (setup.line(setup.detection(shot)).pose for setup in setups)

    assert left.grasp_m[0] < ring.center_m[0] < right.grasp_m[0]
    np.testing.assert_allclose(left.center_m, right.center_m, atol=0.01e-3)
    assert min(np.linalg.norm(usual.grasp_m - each.grasp_m) for each in (left, right)) < 1e-4


def segments_on_plane(laser: int, ends_m) -> list[np.ndarray]:
    """The two segments of a stripe on the plane z = 0.5 m; `ends_m`: outer and inner half width at a place y."""
    outer_m, inner_m = ends_m(height_m(RIG, laser, 0.5))
    return [segment_on_plane(RIG, laser, x_m) for x_m in ((-outer_m, -inner_m), (inner_m, outer_m))]


@pytest.mark.parametrize(
    ("ends_m", "is_ring"),
    [(lambda _: (0.15, 0.13), False), (lambda y_m: np.sqrt(RADIUS_M[::-1] ** 2 - (y_m + 0.01) ** 2), True)],
    ids=["bars", "ring"],
)
def test_two_stripes_across_two_bars_are_no_ring(ends_m, is_ring):
    """Ends on parallel lines lie on two circles, too, about the middle between the stripes."""
    segments = np.array([row for laser in (0, 2) for row in segments_on_plane(laser, ends_m)])

    face = ring_face(segments, (), RIG)

    assert (face is not None and face.opposite is not None) == is_ring


def beside_the_hole() -> list[np.ndarray]:
    """The right pieces of two lasers on a ring, and the stripe of the third one, which passes beside the hole."""
    offset_m = 0.003

    def half_widths_m(y_m):
        outer_m, inner_m = np.sqrt(np.maximum(RADIUS_M[::-1] ** 2 - (y_m - offset_m) ** 2, 0.0))
        return outer_m, inner_m

    rows = [segments_on_plane(laser, half_widths_m)[1] for laser in (0, 1)]
    left, right = segments_on_plane(2, half_widths_m)
    beside = left.copy()
    beside[[X_END, CENTERS, MIDDLE_X]] = right[X_END], right[X_END] - left[X_START], 400.0
    return [*rows, beside]


def test_a_stripe_beside_the_hole_is_on_the_face_of_the_pieces_of_one_arc():
    rows = beside_the_hole()

    face = ring_face(np.array(rows), (), RIG)

    assert face.lasers == (0, 1, 2)
    assert face.passes_beside_hole(2)
    assert not face.displaced
    assert face.opposite.lasers == (2,)


def test_three_pieces_of_one_arc_with_equal_lengths_have_no_opposite_arc():
    rows = [segments_on_plane(laser, lambda y: np.sqrt(RADIUS_M[::-1] ** 2 - (y + 0.03) ** 2))[1] for laser in range(3)]

    face = ring_face(np.array(rows), (), RIG)

    assert face.lasers == (0, 1, 2)
    assert face.opposite is None


def test_a_stripe_beside_the_hole_may_leave_the_image():
    rows = np.array(beside_the_hole())
    rows[:, [X_START, X_END, MIDDLE_X]] -= 400.0
    rows[2, [X_START, MIDDLE_X, CLIPPED]] = 0.0, rows[2, X_END] / 2, 1.0

    face = ring_face(rows, (), RIG)

    assert face.lasers == (0, 1, 2)
    assert not face.displaced


def test_much_foil_does_not_take_the_place_of_the_opposite_arc():
    def half_widths_m(y_m):
        return np.sqrt(RADIUS_M[::-1] ** 2 - y_m**2)

    rows = [row for laser in (0, 2) for row in segments_on_plane(laser, half_widths_m)]
    foil = []
    for number in range(40):  # long pieces one above the other
        piece = rows[number % 2 * 2].copy()
        piece[[CENTERS, X_START, X_END, MIDDLE_X]] = 400.0, 200.0, 600.0, 400.0
        piece[[MIDDLE_Y, SCATTER]] = 30.0 + 13.0 * number, 0.3
        foil.append(piece)

    face = ring_face(np.array([*rows, *foil]), (), RIG)

    assert face.opposite is not None
    assert {tuple(each) for arc in (face, face.opposite) for each in arc.segments} == set(map(tuple, rows))


def flange(light: Light, *, aside_m: float) -> tuple[Shot, Ring]:
    """Frames of a flange of 55 mm that only the middle laser's stripe crosses, that far beside its centre."""
    normal = np.array([0.05, 0.08, -0.99])
    light_normal, distance_m = RIG.lasers.normal[1], RIG.lasers.distance_m[1]
    y_m = float(distance_m - light_normal[2] * 0.5) / float(light_normal[1]) + aside_m
    center_m, radius_m = np.array([0.01, y_m, 0.5]), np.array([0.035, 0.055])
    ring = Ring(center_m=center_m, normal=normal / np.linalg.norm(normal), radius_m=radius_m)
    scene = Scene(
        rig=RIG,
        ring=RingShape(profile_m=np.array([[0.035, 0.0], [0.035, 0.06], [0.055, 0.06], [0.055, 0.0]])),
        body=Body(size_m=np.array([1.0, 1.0, 0.5])),
        lights={"light": light},
        sensor=Sensor(pixel_m=9e-6),
        exposure_s=0.001,
        stripe_dn=170.0,
        sequence=(0, 1, 2, 4),
        views=(RingView(name="view", center_m=ring.center_m, normal=ring.normal, light="light"),),
    )
    return next(iter(simulate(scene)))[0], ring


@pytest.mark.parametrize("aside_m", [0.002, 0.025], ids=["through the centre", "aside"])
def test_one_stripe_and_the_lit_edges_measure_a_flange(aside_m):
    shot, ring = flange(Light(name="light", ambient_w_m2=40.0), aside_m=aside_m)

    line = Setup(rig=RIG).line(Setup(rig=RIG).detection(shot))

    assert not set(line.flag_names) & {"center_weak", "radius_weak", "normal_weak", "grasp_weak"}
    np.testing.assert_allclose(line.pose.center_m, ring.center_m, atol=0.5e-3)
    np.testing.assert_allclose(line.pose.radius_outer_m, 0.055, atol=0.2e-3)


def test_one_stripe_in_the_dark_leaves_the_flange_open():
    shot, _ = flange(Light(name="light"), aside_m=0.025)

    line = Setup(rig=RIG).line(Setup(rig=RIG).detection(shot))

    assert {"center_weak", "radius_weak", "normal_weak", "grasp_weak"} <= set(line.flag_names)


def one_stripe(ends_px: list[float]) -> list[np.ndarray]:
    """Segments of the middle laser in one row, each between two of these places."""
    row = segments_on_plane(1, lambda _: (0.15, 0.13))[0]
    rows = []
    for first, last in zip(ends_px[::2], ends_px[1::2], strict=True):
        piece = row.copy()
        piece[[CENTERS, X_START, X_END, MIDDLE_X]] = last - first, first, last, (first + last) / 2
        rows.append(piece)
    return rows


@pytest.mark.parametrize(
    ("ends_px", "is_ring"),
    [
        ([350.0, 380.0, 420.0, 450.0], True),
        ([350.0, 370.0, 371.0, 430.0], False),
        ([350.0, 380.0, 400.0, 470.0], False),
        ([50.0, 180.0, 620.0, 750.0], False),
    ],
    ids=["one middle", "both on one side", "two middles", "so large that others would cross it"],
)
def test_two_pieces_of_one_stripe_are_a_ring_if_their_ends_have_one_middle(ends_px, is_ring):
    face = ring_face(np.array(one_stripe(ends_px)), (), RIG)

    assert (face is not None and face.opposite is not None) == is_ring


@pytest.mark.parametrize(("nearer_px", "is_ring"), [(0.0, True), (15.0, False)], ids=["alone", "beside a nearer one"])
def test_light_on_the_body_seen_through_a_ring_is_not_taken_for_it(nearer_px, is_ring):
    inside, face = one_stripe([350.0, 380.0, 420.0, 450.0]), one_stripe([452.0, 520.0])
    face[0][MIDDLE_Y] -= nearer_px
    seen = np.array(inside if nearer_px == 0.0 else [*inside, *face])
    seen[:, LASER] = UNLABELLED  # of a frame with several lasers on

    chosen = ring_face(seen, (1,), RIG)

    assert (chosen is not None and chosen.opposite is not None) == is_ring
