"""Which segments make a face: stripes of like length on one band, and none that the body behind may show as well."""

from dataclasses import replace

import numpy as np
import pytest
from benchmarks.stripe_images import Kind, stripe_image, stripe_rig
from ring_scenes import break_points_of, line_of_face, make_scene, with_lines

from ringpose.detect.break_points import without_outliers
from ringpose.detect.rim import Group, best_hypothesis, displaced_lasers, ring_face
from ringpose.geometry.rays import intersect, nearest_plane, undistorted_pixels
from ringpose.geometry.rotations import tilted
from ringpose.kernels.lines import AFTER_END, BEFORE_START, CENTERS, SEGMENT_COLUMNS
from ringpose.types.detection import UNLABELLED, BreakPointFlag
from ringpose.types.rig import LaserPlanes

RIG = stripe_rig()
ALL = (0, 1, 2)
OCCLUDED = int(BreakPointFlag.OCCLUDED)


def row(start, end, laser=UNLABELLED):
    """A clean segment between two points in undistorted pixels."""
    length = end[0] - start[0]
    values = {
        "laser": laser,
        "centers": length,
        "x_start": start[0],
        "x_end": end[0],
        "middle_x": (start[0] + end[0]) / 2,
        "middle_y": (start[1] + end[1]) / 2,
        "slope": (end[1] - start[1]) / length,
        "scatter": 0.05,
        "correlation": 1.0,
    }
    return [float(values.get(name, 0.0)) for name in SEGMENT_COLUMNS]


def face_ends(seed):
    """Left and right ends of the stripes on a true ring's face, undistorted."""
    image = stripe_image(Kind.DARK, seed)
    return undistorted_pixels(image.break_points_px[:, ::-1].reshape(6, 2), RIG.camera).reshape(3, 2, 2)


def body_ends(seed, laser):
    """The body's stripe right of the ring, undistorted."""
    piece = stripe_image(Kind.DARK, seed).pieces_px[3 * laser + 2]
    return undistorted_pixels(piece, RIG.camera)


@pytest.mark.parametrize("seed", range(3))
def test_three_stripes_on_a_ring_are_its_face(seed):
    face = ring_face(np.array([row(*ends) for ends in face_ends(seed)]), ALL, RIG)

    assert face.lasers == ALL
    assert not face.ambiguous


@pytest.mark.parametrize("share", [0.2, 0.35])
def test_a_piece_much_shorter_than_the_other_stripes_is_of_another_surface(share):
    first, (left, right), third = face_ends(1)
    segments = np.array([row(*first), row(left, left + share * (right - left)), row(*third)])

    face = ring_face(segments, ALL, RIG)

    assert face is None or len(face.lasers) < 3


@pytest.mark.parametrize(
    ("pair", "score", "chosen"), [((5, 19), 12.4, (17,)), ((5, 19), 19.5, (5, 19)), ((17, 19), 12.4, (17, 19))]
)
def test_two_pieces_less_like_a_face_than_another_are_the_body_behind_it(pair, score, chosen):
    one = Group((0,), (17,), 9.5, -np.inf)
    two = Group((0, 1), pair, score, -np.inf)

    assert best_hypothesis((one, two, None)).segments == chosen


@pytest.mark.parametrize("seed", range(4))
def test_a_stripe_on_the_body_alone_may_be_of_another_laser(seed):
    face = ring_face(np.array([row(*body_ends(seed, 2))]), ALL, RIG)

    assert face is None or face.ambiguous


@pytest.mark.parametrize("seed", range(4))
def test_the_body_beside_the_ring_has_no_face_however_long_and_straight_its_stripes_are(seed):
    rows = [
        row(*ends(seed, laser), laser)
        for laser in ALL
        for ends in (lambda seed, laser: face_ends(seed)[laser], body_ends)
    ]

    face = ring_face(np.array(rows), (), RIG)

    np.testing.assert_array_equal(face.segments, rows[::2])


def five_lasers(labelled):
    """Stripes on a ring's face of a rig with five lasers, and that rig."""
    pitch = np.deg2rad([-14.0, -7.0, 0.0, 7.0, 14.0])
    normal = np.stack([np.zeros(5), np.cos(pitch), np.sin(pitch)], axis=-1)
    projector_m = np.tile([0.0, -0.08, 0.0], (5, 1))
    distance_m = (normal * projector_m).sum(axis=1)
    lasers = LaserPlanes(names=tuple("abcde"), normal=normal, distance_m=distance_m, projector_m=projector_m)
    scene = make_scene(replace(RIG, lasers=lasers), distance_m=0.5)
    rows = [row(*line_of_face(scene, laser), laser if labelled else UNLABELLED) for laser in range(5)]
    return np.array(rows), scene.rig


@pytest.mark.parametrize("labelled", [True, False])
def test_a_rig_with_five_lasers_uses_all_stripes(labelled):
    segments, rig = five_lasers(labelled)

    face = ring_face(segments, range(5), rig)

    assert face.lasers == (0, 1, 2, 3, 4)
    np.testing.assert_array_equal(face.segments, segments)


def test_a_stripe_of_a_fourth_laser_off_the_rings_plane_is_not_used():
    segments, rig = five_lasers(labelled=True)
    segments[4, SEGMENT_COLUMNS.index("middle_y")] += 6.0

    face = ring_face(segments, range(5), rig)

    assert face.lasers == (0, 1, 2, 3)


def in_front(ends, laser, height_m, slope, shift_m=0.05):
    """The ends of a stripe beside one on the face, of the same laser, on a surface that much nearer to the camera."""
    plane = RIG.lasers.normal[laser], RIG.lasers.distance_m[laser]
    focal_px, principal_px = np.diag(RIG.camera.camera_matrix)[:2], RIG.camera.camera_matrix[:2, 2]
    rays = np.hstack([(ends - principal_px) / focal_px, np.ones((2, 1))])
    points = rays * (plane[1] / (rays @ plane[0]))[:, None]
    points[:, 0] -= shift_m
    points[:, 2] -= height_m + slope * (points[:, 0] - points[0, 0])
    points[:, 1] = (plane[1] - points[:, 0] * plane[0][0] - points[:, 2] * plane[0][2]) / plane[0][1]
    return points[:, :2] / points[:, 2:] * focal_px + principal_px


@pytest.mark.parametrize(
    ("height_m", "slope", "expected"), [(0.03, 0.0, True), (-0.03, 0.0, False), (0.03, 0.5, False), (0.0, 0.0, False)]
)
@pytest.mark.parametrize("laser", ALL)
def test_a_ring_behind_a_parallel_surface_may_be_a_flange_below_the_face(laser, height_m, slope, expected):
    faces = [row(*ends, own) for own, ends in enumerate(face_ends(1))]
    segments = np.array([*faces, row(*in_front(face_ends(1)[laser], laser, height_m, slope), laser)])

    face = ring_face(segments, (), RIG)

    np.testing.assert_array_equal(face.segments, faces)
    assert face.behind is expected


def part_of(ends, share):
    """The ends of a stripe about the middle of another one, of this share of its length."""
    middle = ends.mean(axis=0)
    return middle + share * (ends - middle)


@pytest.mark.parametrize("assigned", [True, False])
@pytest.mark.parametrize("share", [0.4, 0.8])
def test_the_face_is_the_foremost_of_two_rings_however_narrow(share, assigned):
    names = ALL if assigned else [UNLABELLED] * 3
    ends_in_front = [in_front(part_of(ends, share), laser, 0.03, 0.0) for laser, ends in enumerate(face_ends(1))]
    flange = [row(*ends, laser) for laser, ends in zip(names, face_ends(1), strict=True)]
    faces = [row(*ends, laser) for laser, ends in zip(names, ends_in_front, strict=True)]

    face = ring_face(np.array([*flange, *faces]), () if assigned else ALL, RIG)

    assert face.lasers == ALL
    np.testing.assert_array_equal(face.segments, faces)
    assert not face.behind


def test_the_flange_beside_a_face_close_before_it_does_not_speak_against_it():
    """Where the step is small, the flange's stripes are nearly on the lines of the face's."""
    ends_in_front = [in_front(part_of(ends, 0.4), laser, 0.008, 0.0, 0.0) for laser, ends in enumerate(face_ends(1))]
    flange = [row(*ends, laser) for laser, ends in enumerate(face_ends(1))]
    faces = np.array([row(*ends, laser) for laser, ends in enumerate(ends_in_front)])
    faces[:, [BEFORE_START, AFTER_END]] = 0.75 * faces[:, [CENTERS]]

    face = ring_face(np.concatenate([flange, faces]), (), RIG)

    np.testing.assert_array_equal(face.segments, faces)
    assert not face.behind


@pytest.mark.parametrize("assigned", [True, False])
def test_stripes_on_an_arm_that_is_not_parallel_to_the_ring_are_not_on_its_face(assigned):
    names = ALL if assigned else [UNLABELLED] * 3
    ends_on_arm = [in_front(ends, laser, 0.05, 0.3) for laser, ends in enumerate(face_ends(1))]
    faces = [row(*ends, laser) for laser, ends in zip(names, face_ends(1), strict=True)]
    arm = [row(*ends, laser) for laser, ends in zip(names, ends_on_arm, strict=True)]

    face = ring_face(np.array([*faces, *arm]), () if assigned else ALL, RIG)

    np.testing.assert_array_equal(face.segments, faces)
    assert not face.behind
    assert ring_face(np.array(arm), () if assigned else ALL, RIG).lasers == ALL  # alone, they would be a face


def test_two_narrow_stripes_in_front_may_be_all_that_is_seen_of_the_face():
    flange = [row(*ends, laser) for laser, ends in enumerate(face_ends(1))]
    faces = [row(*in_front(part_of(face_ends(1)[laser], 0.4), laser, 0.03, 0.0), laser) for laser in (0, 1)]

    assert ring_face(np.array([*flange, *faces]), (), RIG).behind
    assert not ring_face(np.array([*flange, *faces[:1]]), (), RIG).behind


def points_with_one_wrong(seed, by_px, *, labelled):
    """The break points of a true ring, but the right one of the second stripe lies farther out."""
    position = stripe_image(Kind.DARK, seed).break_points_px[:, ::-1].copy()
    position[1, 1, 0] += by_px
    return replace(with_lines(break_points_of(position, 0.05), face_ends(seed), 0.01), labelled=labelled)


@pytest.mark.parametrize("labelled", [True, False])
def test_a_wrong_end_is_rejected_and_the_line_of_its_stripe_is_kept(labelled):
    found, rejected, _ = without_outliers(points_with_one_wrong(1, 300.0, labelled=labelled), RIG)

    # what hid one end may have hidden the other one, which alone would determine the curvature
    assert {(each.what, each.laser) for each in rejected} == {("point", RIG.lasers.names[1])}
    assert np.isnan(found.position_px[1]).all()
    assert not np.isnan(found.position_px[[0, 2]]).any()
    assert found.flags[1].max() & OCCLUDED
    assert not np.isnan(found.face_start_undistorted_px).any()


def test_break_points_of_one_ring_are_all_kept():
    found, rejected, _ = without_outliers(points_with_one_wrong(1, 0.0, labelled=True), RIG)

    assert rejected == ()
    assert found.seen.all()


def third_stripe(seed, height_m, slope=0.0):
    """Segments of two stripes on a face, and that of the third laser on a surface that much nearer to the camera."""
    return np.array(
        [
            row(*face_ends(seed)[0], 0),
            row(*in_front(face_ends(seed)[1], 1, height_m, slope, shift_m=0.0), 1),
            row(*face_ends(seed)[2], 2),
        ]
    )


@pytest.mark.parametrize(
    ("height_m", "slope", "expected"),
    [(0.01, 0.0, (1,)), (-0.01, 0.1, (1,)), (0.03, 0.0, (1,)), (-0.03, 0.0, (1,)), (0.03, 0.1, ()), (-0.05, 0.0, ())],
)
def test_a_third_stripe_beside_the_plane_of_two_shows_that_one_is_displaced(height_m, slope, expected):
    segments = third_stripe(1, height_m, slope)
    face = ring_face(segments[[0, 2]], (), RIG)

    assert face.lasers == (0, 2)
    assert displaced_lasers(face, segments, (), RIG) == expected


def with_turned_plane(laser, deg):
    """The rig with the light plane of one laser turned in depth."""
    normal = RIG.lasers.normal.copy()
    normal[laser] = tilted(normal[laser], np.array([0.0, np.tan(np.deg2rad(deg))]))
    return replace(RIG, lasers=replace(RIG.lasers, normal=normal))


def coplanar_piece(ends, laser, shift_px, rig):
    """A piece as long as a laser's stripe, but beside it, in the plane of the other two as this rig has it."""
    others = [each for each in ALL if each != laser]
    normal, distance_m = rig.lasers.normal, rig.lasers.distance_m
    rays = np.concatenate([(ends[others].reshape(-1, 2) - (800.0, 600.0)) / 1778.0, np.ones((4, 1))], axis=1)
    of = np.repeat(others, 2)
    points_m = intersect(rays, normal[of], distance_m[of])
    across = nearest_plane(points_m)[0]
    a, b, c = normal[laser] / distance_m[laser] - across / (across @ points_m.mean(axis=0))
    x = (ends[laser][:, 0] + shift_px - 800.0) / 1778.0
    return np.stack([x, -(a * x + c) / b], axis=1) * 1778.0 + (800.0, 600.0)


@pytest.mark.parametrize("labelled", [True, False])
@pytest.mark.parametrize(("turned", "deg", "shift_px"), [(2, -0.2, 150), (2, 0.2, -200), (2, 0.4, 150), (1, 0.4, 250)])
def test_a_piece_beside_the_ring_is_not_taken_for_the_stripe_of_a_light_plane_that_has_moved(
    turned, deg, shift_px, labelled
):
    ends, moved = face_ends(2 if turned == 1 else 3), with_turned_plane(turned, deg)
    piece = coplanar_piece(ends, 0, shift_px, moved)
    lasers = [0, 0, 1, 2] if labelled else [UNLABELLED] * 4
    segments = np.array([row(*each, laser) for each, laser in zip([piece, *ends], lasers, strict=True)])
    unlabelled = () if labelled else ALL

    face = ring_face(segments, unlabelled, moved)

    assert ring_face(segments[[0, 2, 3]], unlabelled, moved).lasers == ALL
    assert face.lasers == (1, 2)
    assert face.displaced == (0,)
    assert ring_face(segments, unlabelled, RIG).lasers == ALL


@pytest.mark.parametrize("seed", range(1, 4))
def test_two_stripes_are_a_face_where_the_third_passes_through_a_gap_of_the_ring(seed):
    faces = [row(*face_ends(seed)[laser], laser) for laser in (0, 1)]
    body = [row(*body_ends(seed, laser), laser) for laser in (0, 1)]
    start, end = body_ends(seed, 2)
    through_gap = row(end - 4.0 * (end - start), end, 2)

    face = ring_face(np.array([*faces, *body, through_gap]), (), RIG)

    np.testing.assert_array_equal(face.segments, faces)
    assert not face.behind
    assert ring_face(np.array([*faces, *body]), (), RIG).score < face.score  # nothing shows where that light is


@pytest.mark.parametrize("seed", range(1, 4))
@pytest.mark.parametrize("laser", ALL)
def test_two_stripes_of_which_one_is_on_the_floor_of_a_groove_are_no_face(seed, laser):
    """A third stripe as long as theirs would stand in front of the plane of these two."""
    rows = [row(*ends, own) for own, ends in enumerate(face_ends(seed))]
    rows[laser] = row(*in_front(face_ends(seed)[laser], laser, -0.04, 0.0, shift_m=0.0), laser)

    face = ring_face(np.array(rows), (), RIG)

    assert face.lasers == tuple(own for own in ALL if own != laser)


def interrupted(seed, height_m):
    """Both pieces of each stripe on a face, and what stands on its middle third on two of them."""
    rows = []
    for laser, ends in enumerate(face_ends(seed)):
        start, end = ends
        thirds = [start, start + 0.36 * (end - start), start + 0.64 * (end - start), end]
        pieces = [row(*thirds[:2], laser), row(*thirds[2:], laser)]
        for piece, inside in zip(pieces, ("after_end", "before_start"), strict=True):
            piece[SEGMENT_COLUMNS.index(inside)] = 40.0
        rows += pieces
        if laser:
            rows.append(row(*in_front(np.stack(thirds[1:3]), laser, height_m, 0.0, shift_m=0.0), laser))
    return np.array(rows)


@pytest.mark.parametrize("seed", range(1, 4))
def test_two_springs_on_the_stripes_of_a_face_interrupt_them(seed):
    face = ring_face(interrupted(seed, 0.02), (), RIG)

    assert face.lasers == ALL
    assert not face.behind
    ends_px = face.segments[:, [SEGMENT_COLUMNS.index("x_start"), SEGMENT_COLUMNS.index("x_end")]]
    np.testing.assert_allclose(ends_px, face_ends(seed)[..., 0])


@pytest.mark.parametrize("seed", range(1, 4))
def test_stripes_that_go_on_beyond_the_band_of_a_third_are_contradicted_by_it(seed):
    """A blanket over the outer edge, seen with the face as one straight stripe, is longer than a third whole stripe."""
    rows = [row(*ends, laser) for laser, ends in enumerate(face_ends(seed))]
    for laser in (1, 2):
        start, end = face_ends(seed)[laser]
        rows[laser] = row(end - 3.0 * (end - start), end, laser)

    face = ring_face(np.array(rows), (), RIG)

    assert face.lasers == (1, 2)
    assert face.displaced == (0,)
