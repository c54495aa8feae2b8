"""The kernel that looks for the ring's face among segments."""

from dataclasses import replace
from typing import NamedTuple

import numpy as np
import pytest
from drawn_scene import DrawnScene, drawn_rig, true_break_points

from ringpose.detect.rim import ring_faces
from ringpose.geometry.rays import undistorted_pixels
from ringpose.kernels.lines import SEGMENT_COLUMNS, CandidateParams, RingParams, UnionParams
from ringpose.optics.feature_errors import AGREEMENT


class Rules(NamedTuple):
    """Parameters of `ring_faces`."""

    ring: RingParams
    unions: UnionParams = UnionParams(separation_sigmas=3.0)
    candidates: CandidateParams = CandidateParams()


RULES = Rules(RingParams(focal_x=1781.0, focal_y=1780.0, principal_x=803.0, principal_y=596.0))
ANY = 0b111


def with_rules(**changed):
    """The rules with some changed."""
    parts = [replace(part, **{k: v for k, v in changed.items() if hasattr(part, k)}) for part in RULES]
    return Rules(*parts)


def rules_of(rig):
    matrix = rig.camera.camera_matrix
    focal, principal = matrix[[0, 1], [0, 1]].tolist(), matrix[:2, 2].tolist()
    return dict(zip(("focal_x", "focal_y", "principal_x", "principal_y"), [*focal, *principal], strict=True))


def planes():
    lasers = drawn_rig().lasers
    return lasers.normal / lasers.distance_m[:, None]


def tracks_between(start_px, end_px, *, count=40.0, scatter=0.1, spilt=0.0, laser=-1.0, clipped=0.0):
    """Segments from there to there, undistorted pixels; the rest is the same for all, or given for each."""
    middle = (start_px + end_px) / 2
    slope = (end_px[:, 1] - start_px[:, 1]) / (end_px[:, 0] - start_px[:, 0])
    columns = (laser, count, start_px[:, 0], end_px[:, 0], *middle.T, slope, scatter, 2.0, clipped, spilt, 0.0)
    return np.stack(np.broadcast_arrays(*columns), axis=-1).astype(np.float64)


def true_ends(rng, *, moved_px=0.0):
    """Undistorted ends (laser, end, xy) of a true ring's stripes, moved by noise."""
    rig = drawn_rig()
    scene = DrawnScene(center_m=(0.58, rng.uniform(-0.05, 0.05), rng.uniform(0.3, 1.0)))
    position = true_break_points(scene, rig)[:, ::-1]
    return undistorted_pixels(position + rng.normal(0, moved_px, position.shape), rig.camera)


def crowd(rng, count):
    """A true ring's stripes, one of them in two pieces, among random ones."""
    ends = np.concatenate([true_ends(rng, moved_px=0.3), rng.uniform(100, 1100, (count, 2, 2))])
    ends[4:, 1] = ends[4:, 0] + [60.0, 0.0] + rng.normal(0, 3, (count - 1, 2))
    ends[3], along = ends[2], ends[2, 1] - ends[2, 0]
    ends[2, 1] -= 0.6 * along
    ends[3, 0] += 0.5 * along
    true = np.arange(len(ends)) < 4
    return tracks_between(
        ends[:, 0],
        ends[:, 1],
        count=rng.integers(10, 200, len(ends)),
        scatter=rng.uniform(0.05, 0.4, len(ends)),
        spilt=rng.integers(5, 60, len(ends)) * ~(true & (np.arange(len(ends)) < 2)),
        laser=np.where(true, -1.0, rng.choice([-1.0, -1.0, 0.0, 1.0, 2.0], len(ends))),
        clipped=(rng.random(len(ends)) < 0.1) & ~true,
    )


def exact_score(segments, params):
    return ring_faces(segments, ANY, planes(), *params).groups[2].score


def test_an_end_beyond_the_border_is_not_observed_and_may_lie_off_the_circles(rng):
    params, ends = with_rules(**rules_of(drawn_rig())), true_ends(rng)
    moved = ends.copy()
    moved[:, 0] += 0.03 * (ends[:, 1] - ends[:, 0]) * np.array([[1.0], [-1.0], [2.0]])
    left_x = (moved[:, 0, 0].max() - params.ring.principal_x) / params.ring.focal_x + 1e-3
    cut = params._replace(ring=replace(params.ring, left_x=float(left_x)))

    exact = exact_score(tracks_between(ends[:, 0], ends[:, 1]), params)
    found = exact_score(tracks_between(moved[:, 0], moved[:, 1]), cut)

    assert found == pytest.approx(exact - 3 * AGREEMENT, abs=0.01)


def test_a_stripe_of_which_the_border_cuts_off_both_ends_shows_no_face(rng):
    params, ends = with_rules(**rules_of(drawn_rig())), true_ends(rng)
    inside = (
        np.array([ends[1, :, 0].min() + 1, ends[1, :, 0].max() - 1]) - params.ring.principal_x
    ) / params.ring.focal_x
    cut = params._replace(ring=replace(params.ring, left_x=float(inside[0]), right_x=float(inside[1])))

    assert exact_score(tracks_between(ends[1:2, 0], ends[1:2, 1]), cut) == -np.inf
    assert ring_faces(tracks_between(ends[1:2, 0], ends[1:2, 1]), ANY, planes(), *cut).groups[0].lasers == (-1,)


@pytest.mark.parametrize(("nearer_px", "penalised"), [(30.0, True), (-30.0, False)])
def test_an_end_at_a_nearer_surface_is_not_the_stripes_own(rng, nearer_px, penalised):
    params, ends = with_rules(**rules_of(drawn_rig())), true_ends(rng)
    beside = ends[0, 1] + [[2.0, 0.0], [62.0, 0.0]] + np.array([0.0, nearer_px * np.sign(planes()[0, 1])])
    segments = [np.concatenate(each) for each in ((ends[:, 0], beside[:1]), (ends[:, 1], beside[1:]))]

    alone = exact_score(tracks_between(ends[:, 0], ends[:, 1], laser=np.arange(3.0)), params)
    found = exact_score(tracks_between(*segments, laser=np.array([0.0, 1.0, 2.0, 0.0])), params)

    assert found == pytest.approx(alone - penalised * AGREEMENT, abs=0.01)


def test_the_true_ring_wins_under_its_true_labels(rng):
    ends = np.concatenate([true_ends(rng, moved_px=0.3), rng.uniform(100, 1100, (8, 2, 2))])
    segments = tracks_between(*np.moveaxis(ends, 1, 0))

    best = ring_faces(segments, ANY, planes(), *with_rules(**rules_of(drawn_rig()))).groups[2]

    assert (best.lasers, best.segments) == ((0, 1, 2), (0, 1, 2))


@pytest.mark.parametrize("seed", range(8))
def test_more_tracks_never_lower_the_best_score(seed):
    segments, params = crowd(np.random.default_rng(seed), 9), with_rules(**rules_of(drawn_rig()))
    params = params._replace(candidates=replace(params.candidates, max_candidates=100))

    scores = [exact_score(segments[:count], params) for count in (4, 7, 10, len(segments))]

    assert np.isfinite(scores[0])
    assert (np.diff(scores) >= 0).all()


@pytest.mark.parametrize("seed", range(8))
def test_tracks_in_another_order_give_the_same_groups(seed):
    rng = np.random.default_rng(seed)
    segments, params = crowd(rng, 9), with_rules(**rules_of(drawn_rig()))
    order = rng.permutation(len(segments))

    found, other = (ring_faces(each, ANY, planes(), *params) for each in (segments, segments[order]))

    for here, there in zip(found.groups, other.groups, strict=True):
        assert here.score == pytest.approx(there.score, abs=1e-6)
        rows, others = (
            each.segments[[segment for _, segment in sorted(zip(group.lasers, group.segments, strict=True))]]
            for each, group in ((found, here), (other, there))
        )
        np.testing.assert_allclose(rows, others, rtol=1e-9)


def test_an_exact_ring_costs_its_tilt(rng):
    ends = true_ends(rng)
    segments = tracks_between(ends[:, 0], ends[:, 1], count=40.0, scatter=0.3)

    score = exact_score(segments, with_rules(**rules_of(drawn_rig())))

    tilt = np.arctan2(np.hypot(0.05, 0.08), 0.9955)
    assert score == pytest.approx(3 * (2 * np.log(40.0) - 0.5) - 0.5 * (tilt / 0.5) ** 2, abs=1e-5)


def stripes_of_nearly_parallel_planes(depth_m):
    """The light planes (as m / d) of the paper's virtual rig, and where a ring facing its camera shows its stripes."""
    pitch = np.deg2rad([1.5, 0.0, -1.5])
    y_m = (-0.1 - np.sin(pitch) * depth_m) / np.cos(pitch)
    x_m = 0.58 - np.sqrt(np.array([0.597, 0.567]) ** 2 - y_m[:, None] ** 2)
    ends = np.stack(np.broadcast_arrays(x_m, y_m[:, None]), axis=-1) / depth_m * 960.0 + [799.5, 599.5]
    light = np.stack([np.zeros(3), np.cos(pitch), np.sin(pitch)], axis=-1) / -0.1
    return light, tracks_between(ends[:, 0], ends[:, 1])


AFTER_END = SEGMENT_COLUMNS.index("after_end")

WIDE = {"focal_x": 960.0, "focal_y": 960.0, "principal_x": 799.5, "principal_y": 599.5}


@pytest.mark.parametrize("lasers", [ANY, 0b010], ids=["all lasers", "one"])
def test_other_lasers_stripes_on_the_body_that_happen_to_lie_on_a_stripes_line_are_no_reason_against_it(lasers):
    """At half a metre the next laser's stripe on a body 60 mm behind runs where this one's on the ring does."""
    light, segments = stripes_of_nearly_parallel_planes(0.5)
    alone = ring_faces(segments, ANY, light, *with_rules(**WIDE)).groups[2].score
    segments[1:, AFTER_END] = 3 * 40.0
    segments[:, 0] = np.where([lasers == ANY] * 3, -1.0, [0, 1, 2])

    found = ring_faces(segments, lasers, light, *with_rules(**WIDE)).groups[2]

    assert found.segments == (0, 1, 2)
    assert alone - found.score == pytest.approx(2 * (AGREEMENT if lasers == ANY else 0.75 * 15.0))


def test_what_lies_on_the_line_of_the_nearest_of_parallel_stripes_can_be_no_other_lasers():
    light, segments = stripes_of_nearly_parallel_planes(0.5)
    segments[0, AFTER_END] = 3 * 40.0

    found = ring_faces(segments, ANY, light, *with_rules(**WIDE)).groups[2]

    segments[0, AFTER_END] = 0.0
    assert ring_faces(segments, ANY, light, *with_rules(**WIDE)).groups[2].score - found.score == pytest.approx(
        0.75 * 15
    )


@pytest.mark.parametrize("lasers", [0b011, 0b001, 0])
def test_tracks_without_a_laser_belong_to_none_but_the_given_ones(rng, lasers):
    ends = true_ends(rng)

    groups = ring_faces(tracks_between(ends[:, 0], ends[:, 1]), lasers, planes(), *with_rules()).groups

    assert [group.score > -np.inf for group in groups] == [lasers.bit_count() >= size for size in (1, 2, 3)]


def track_of(x, y, spilt=20.0, laser=-1.0, clipped=0.0):
    """The segment that least squares make of centres."""
    slope, offset = np.polyfit(x, y, 1)
    scatter = (y - offset - slope * x).std()
    return np.array([laser, len(x), x[0], x[-1], x.mean(), y.mean(), slope, scatter, 1.0, clipped, spilt, spilt])


def halves(rng, step_px=0.0, **of_second):
    """Two segments on one line, the second off it by a step; and the segment of both."""
    x = np.concatenate([np.arange(100.0, 140.0), np.arange(150.0, 200.0)])
    y = 300.0 + 0.05 * x + rng.normal(0, 0.3, len(x)) + step_px * (x >= 150)
    return np.stack([track_of(x[:40], y[:40]), track_of(x[40:], y[40:], **of_second)]), track_of(x, y)


def test_a_union_is_the_line_through_all_centres(rng):
    segments, expected = halves(rng)

    (*_, both) = ring_faces(segments, ANY, planes(), *RULES).segments

    found, wanted = (dict(zip(SEGMENT_COLUMNS, row.tolist(), strict=True)) for row in (both, expected))
    assert found["middle_x"] == pytest.approx(wanted["middle_x"])
    assert found["middle_y"] == pytest.approx(wanted["middle_y"], abs=0.01)
    assert found["slope"] == pytest.approx(wanted["slope"], abs=3e-4)
    assert found["scatter"] == pytest.approx(wanted["scatter"], rel=0.05)


def test_what_lies_on_the_line_between_two_pieces_is_not_beyond_the_ends_of_their_union(rng):
    segments, _ = halves(rng)
    segments[0, -2:], segments[1, -2:] = (3.0, 60.0), (45.0, 7.0)

    (*_, both) = ring_faces(segments, ANY, planes(), *RULES).segments

    assert both[-2:].tolist() == [3.0, 7.0]


def test_pieces_of_one_line_are_tried_as_one_whatever_their_order(rng):
    segments, _ = halves(rng)

    (*_, both) = ring_faces(segments[::-1].copy(), ANY, planes(), *RULES).segments

    found = dict(zip(SEGMENT_COLUMNS, both.tolist(), strict=True))
    assert (found["x_start"], found["x_end"], found["centers"]) == (100.0, 199.0, 90.0)


@pytest.mark.parametrize(
    "of_second",
    [{"step_px": 3.0}, {"spilt": 0.0}, {"laser": 1.0}, {"clipped": 1.0}],
    ids=["off", "whole", "other", "clipped"],
)
def test_what_cannot_be_one_stripe_is_not_joined(rng, of_second):
    segments, _ = halves(rng, **of_second)

    assert len(ring_faces(segments, ANY, planes(), *RULES).segments) == 2


def test_no_tracks_give_no_group():
    groups = ring_faces(np.zeros((0, len(SEGMENT_COLUMNS))), ANY, planes(), *RULES).groups

    assert [group.score for group in groups] == [-np.inf] * 3


@pytest.mark.parametrize("laser", [3.0, -2.0, np.nan])
def test_a_laser_beyond_the_rig_is_rejected(rng, laser):
    segments = crowd(rng, 4)
    segments[2, 0] = laser

    with pytest.raises(ValueError, match="number 2 is of a laser"):
        ring_faces(segments, ANY, planes(), *RULES)


@pytest.mark.parametrize(
    "wrong", [{"max_candidates": 0}, {"max_candidates": 10**9}, {"max_gap": np.nan}, {"rounds": 100}]
)
def test_parameters_out_of_range_are_a_value_error(rng, wrong):
    with pytest.raises(ValueError, match=f"{next(iter(wrong))}: is"):
        ring_faces(crowd(rng, 4), ANY, planes(), *with_rules(**wrong))


@pytest.mark.parametrize("value", [np.nan, np.inf, 0.0, 1e300])
@pytest.mark.parametrize("column", range(1, len(SEGMENT_COLUMNS)))
def test_wild_tracks_give_no_crash(rng, column, value):
    segments = crowd(rng, 6)
    segments[::2, column] = value

    assert len(ring_faces(segments, ANY, planes(), *RULES).groups) == 3
