"""A single outlier is found, named and rejected; the rest gives the pose."""

from dataclasses import replace

import numpy as np
import pytest
from moving_cameras import SeenByRobot, in_base, robot
from moving_rings import START_S, Motion
from ring_scenes import RIGS, break_points_of, face_points_of, make_scene, scene_of, with_lines, with_stripes

from ringpose.bench.design.rig_changes import with_changes
from ringpose.detect.break_points import without_outliers
from ringpose.files.scenes.scene import read_scene
from ringpose.files.studies.specification import PRESETS
from ringpose.geometry.rotations import angle_between
from ringpose.measure.stream import estimate_pose, pose_result
from ringpose.types.assumptions import USUAL, Assumptions, motion_prior
from ringpose.types.detection import BreakPointFlag
from ringpose.types.pose import HARMLESS_FLAGS, KnownRadii, PoseFlag, RingPose
from ringpose.types.rig import LaserPlanes

KNOWN = KnownRadii(radius_m=np.array([0.567, 0.597]), sd_m=np.array([2e-4, 2e-4]))
OTHER = KnownRadii(radius_m=np.array([0.64, 0.67]), sd_m=np.array([2e-4, 2e-4]))
CONTRADICTIONS = (
    PoseFlag.RADIUS_INCONSISTENT
    | PoseFlag.INCONSISTENT
    | PoseFlag.POINT_REJECTED
    | PoseFlag.STRIPE_REJECTED
    | PoseFlag.ASSIGNMENT_AMBIGUOUS
)
EVERY_POINT = pytest.mark.parametrize(
    ("laser", "edge"),
    [(0, 0), (1, 1), (2, 1), *(pytest.param(*each, marks=pytest.mark.slow) for each in ((0, 1), (1, 0), (2, 0)))],
)


@pytest.fixture
def scene():
    return make_scene("B", distance_m=0.5, tilt_rad=(0.15, -0.1))


@pytest.fixture
def points(scene, rng):
    return face_points_of(scene, 0.3, 0.01, rng)


def shifted(points, laser, edge, shift_px):
    """A break point moved along its stripe."""
    position = points.position_px.copy()
    along = position[laser, 1] - position[laser, 0]
    position[laser, edge] += shift_px * along / np.linalg.norm(along)
    return replace(points, position_px=position)


def lifted(points, laser, shift_px):
    """A stripe on something else: line and ends moved across."""
    position, start, end = (
        points.position_px.copy(),
        points.face_start_undistorted_px.copy(),
        points.face_end_undistorted_px.copy(),
    )
    for part in (position, start, end):
        part[laser, ..., 1] += shift_px
    return replace(points, position_px=position, face_start_undistorted_px=start, face_end_undistorted_px=end)


def exchanged(points, first, second):
    """Two lasers' stripes under each other's names."""
    order = np.arange(len(points.flags))
    order[[first, second]] = second, first
    names = (
        "position_px",
        "covariance_px2",
        "flags",
        "face_start_undistorted_px",
        "face_end_undistorted_px",
        "face_sigma_px",
    )
    return replace(points, **{name: getattr(points, name)[order] for name in names})


def sigmas_off(pose, scene):
    """Mahalanobis distance of the centre from the truth."""
    error = pose.center_m - scene.ring.center_m
    return np.sqrt(error @ np.linalg.solve(pose.covariance_center_m2, error))


@EVERY_POINT
@pytest.mark.parametrize("shift_px", [pytest.param(-25.0, marks=pytest.mark.slow), 12.0])
def test_a_wrong_break_point_is_left_out(scene, points, laser, edge, shift_px):
    pose = estimate_pose(shifted(points, laser, edge, shift_px), scene.rig, known=KNOWN)

    assert PoseFlag.POINT_REJECTED in pose.flags
    assert scene.rig.lasers.names[laser] in pose.remark
    assert sigmas_off(pose, scene) < 4.0


@EVERY_POINT
def test_a_wrong_break_point_without_a_known_radius_does_no_harm(scene, points, laser, edge):
    pose = estimate_pose(shifted(points, laser, edge, 20.0), scene.rig)

    assert pose.flags & (PoseFlag.POINT_REJECTED | PoseFlag.INCONSISTENT)
    assert PoseFlag.CENTER_WEAK in pose.flags or sigmas_off(pose, scene) < 5.0


@pytest.mark.parametrize("laser", range(3))
def test_an_occluder_over_both_ends_of_one_stripe_is_owned_up_to(scene, points, laser):
    hidden = shifted(shifted(points, laser, 0, 18.0), laser, 1, -25.0)

    pose = estimate_pose(hidden, scene.rig, known=KNOWN)

    assert pose.flags & (PoseFlag.POINT_REJECTED | PoseFlag.STRIPE_REJECTED | PoseFlag.INCONSISTENT)
    assert scene.rig.lasers.names[laser] in pose.remark or PoseFlag.INCONSISTENT in pose.flags
    assert sigmas_off(pose, scene) < 5.0


@pytest.mark.slow
def test_a_stripe_of_which_both_ends_are_wrong_leaves_the_center_weak_or_true_where_nothing_else_tells_it(scene, rng):
    poses = []
    for _ in range(10):
        # not both the same way: that is what another ring looks like
        shifts_px = rng.uniform(8.0, 30.0, 2) * rng.permutation([-1.0, 1.0])
        points = face_points_of(scene, 0.3, 0.01, rng)
        hidden = shifted(shifted(points, 1, 0, shifts_px[0]), 1, 1, shifts_px[1])
        poses.append(estimate_pose(hidden, scene.rig))

    sure = [pose for pose in poses if PoseFlag.CENTER_WEAK not in pose.flags]
    assert max([sigmas_off(pose, scene) for pose in sure], default=0.0) < 5.0
    assert sum(bool(pose.flags) for pose in poses) >= 9


def test_the_other_end_of_a_stripe_is_used_where_the_radius_confirms_it(scene, points):
    pose = estimate_pose(shifted(points, 1, 0, 20.0), scene.rig, known=KNOWN)

    assert "both" not in pose.remark
    assert sigmas_off(pose, scene) < 4.0


@pytest.mark.parametrize("laser", range(3))
def test_a_wrong_stripe_is_left_out_or_owned_up_to(scene, points, laser):
    pose = estimate_pose(lifted(points, laser, 8.0), scene.rig, known=KNOWN)

    assert pose.flags & (PoseFlag.STRIPE_REJECTED | PoseFlag.INCONSISTENT)
    assert sigmas_off(pose, scene) < 5.0


@pytest.mark.parametrize("pair", [(0, 1), (1, 2), (0, 2)])
def test_exchanged_lasers_are_put_right(scene, points, pair):
    pose = estimate_pose(replace(exchanged(points, *pair), labelled=False), scene.rig, known=KNOWN)

    assert PoseFlag.ASSIGNMENT_AMBIGUOUS in pose.flags
    assert sigmas_off(pose, scene) < 4.0


@pytest.mark.parametrize("pair", [(0, 3), (1, 2)])
def test_two_exchanged_lasers_of_four_are_put_right(pair, rng):
    planes = RIGS["B"].lasers
    added = np.array([0.0, np.cos(0.09), -np.sin(0.09)])
    lasers = LaserPlanes(
        names=(*planes.names, "fourth"),
        normal=np.vstack([planes.normal, added]),
        distance_m=np.append(planes.distance_m, -0.055),
        projector_m=np.full((4, 3), np.nan),
    )
    scene = make_scene(replace(RIGS["B"], lasers=lasers), distance_m=0.5, tilt_rad=(0.15, -0.1))

    points = face_points_of(scene, 0.3, 0.01, rng)

    pose = estimate_pose(replace(exchanged(points, *pair), labelled=False), scene.rig, known=KNOWN)

    assert PoseFlag.ASSIGNMENT_AMBIGUOUS in pose.flags
    assert sigmas_off(pose, scene) < 4.0


def test_a_radius_that_is_wrong_is_left_out(scene, points):
    pose = estimate_pose(points, scene.rig, known=OTHER)

    assert PoseFlag.RADIUS_INCONSISTENT in pose.flags
    assert sigmas_off(pose, scene) < 4.0


OTHER_RADII = (
    ("R1194", (0.567, 0.597)),
    ("R597", (1.154, 1.194)),
    ("R833", (0.567, 0.597)),
    ("R597", (0.803, 0.833)),
)


@pytest.mark.parametrize(
    ("size", "said", "distance_m"),
    [
        pytest.param(
            *radii,
            distance_m,
            id=f"{radii[0]}-said{number}-{distance_m}",
            marks=() if (number + near) % 3 == 0 else pytest.mark.slow,  # each ring and each distance is in a fast one
        )
        for number, radii in enumerate(OTHER_RADII)
        for near, distance_m in enumerate((0.25, 0.5, 1.0))
        if (number + near) % 3 < 2
    ],
)
def test_radii_of_another_ring_are_owned_up_to(rng, distance_m, size, said):
    scene = make_scene("B", distance_m=distance_m, size=size)
    known = KnownRadii(radius_m=np.array(said), sd_m=np.full(2, 5e-4))

    results = [pose_result(face_points_of(scene, 0.3, 0.01, rng), scene.rig, known=known) for _ in range(3)]

    assert all(result.flags & CONTRADICTIONS for result in results)
    assert all(result.remark for result in results)
    # where another explanation is as likely as a wrong radius, only what they have in common is reported
    reported = [result.pose for result in results if isinstance(result.pose, RingPose)]
    centers = [pose for pose in reported if np.isfinite(pose.center_m).all()]
    assert max((sigmas_off(pose, scene) for pose in centers), default=0.0) < 5.0
    assert all(pose.normal @ scene.ring.normal > np.cos(0.02) for pose in reported if np.isfinite(pose.normal).all())


def test_no_shot_tells_radii_that_it_cannot_see_from_wrong_ones(rng):
    # 1.5 degrees between the lasers see too little of the arc: what is said of the ring is believed
    scene = make_scene("A", distance_m=0.5, size="R833")

    pose = estimate_pose(face_points_of(scene, 0.3, 0.01, rng), scene.rig, known=KNOWN)

    assert not pose.flags & ~HARMLESS_FLAGS


@pytest.mark.slow
def test_a_good_shot_is_rarely_doubted(scene, rng):
    poses = [estimate_pose(face_points_of(scene, 0.3, 0.01, rng), scene.rig, known=KNOWN) for _ in range(600)]

    assert sum(bool(pose.flags & ~HARMLESS_FLAGS) for pose in poses) <= 3  # 0.8 of 600 by chance; 99 % by Poisson


@EVERY_POINT
@pytest.mark.parametrize("shift_px", [pytest.param(-400.0, marks=pytest.mark.slow), 700.0])
def test_a_break_point_far_away_never_passes_for_a_ring(scene, points, laser, edge, shift_px):
    pose = estimate_pose(shifted(points, laser, edge, shift_px), scene.rig)

    assert PoseFlag.POINT_REJECTED in pose.flags
    assert pose.normal @ scene.ring.normal > np.cos(0.005)


@pytest.mark.parametrize("laser", range(3))
@pytest.mark.parametrize("rise_px", [-200.0, 200.0])
def test_a_line_that_leaves_its_stripe_is_left_out_or_owned_up_to(scene, points, laser, rise_px):
    end = points.face_end_undistorted_px.copy()
    end[laser, 1] += rise_px

    pose = estimate_pose(replace(points, face_end_undistorted_px=end), scene.rig)

    assert pose.flags & (PoseFlag.STRIPE_REJECTED | PoseFlag.INCONSISTENT)
    assert scene.rig.lasers.names[laser] in pose.remark or PoseFlag.INCONSISTENT in pose.flags


@pytest.mark.parametrize("labelled", [True, False])
def test_exchanged_lasers_never_make_a_sure_ring_somewhere_else(rng, labelled):
    scene = make_scene("B", distance_m=1.0, tilt_rad=(0.05, 0.05), size="R833")
    points = exchanged(face_points_of(scene, 0.3, 0.01, rng), 0, 1)

    result = pose_result(replace(points, labelled=labelled), scene.rig)

    assert PoseFlag.ASSIGNMENT_AMBIGUOUS in result.flags
    if isinstance(result.pose, RingPose) and np.isfinite(result.pose.center_m).all():
        assert sigmas_off(result.pose, scene) < 5.0


def test_what_still_disagrees_without_the_part_to_blame_says_so(scene, points):
    both = shifted(lifted(points, 0, 30.0), 2, 1, 25.0)

    result = pose_result(both, scene.rig, known=KNOWN)

    assert result.flags & CONTRADICTIONS
    if isinstance(result.pose, RingPose) and PoseFlag.CENTER_WEAK not in result.flags:
        assert sigmas_off(result.pose, scene) < 5.0


def two_stripes_one_on_the_background(scene, points, rng, end_sigma_px):
    """The first two stripes; the second one is a stripe on a surface behind the ring, with ends of no edge."""
    shift_px = rng.uniform(20.0, 60.0) * rng.choice([-1.0, 1.0])
    moved = lifted(points, 1, shift_px)
    position, covariance = moved.position_px.copy(), moved.covariance_px2.copy()
    position[1, :, 0] += rng.uniform(-50.0, 50.0, 2)
    covariance[1] = np.diag([end_sigma_px**2, 0.3**2])
    position[2] = np.nan
    unseen = np.full(2, np.nan)
    start, end, sigma = (
        moved.face_start_undistorted_px.copy(),
        moved.face_end_undistorted_px.copy(),
        moved.face_sigma_px.copy(),
    )
    end[1, 1] += rng.uniform(-15.0, 15.0)
    start[2], end[2], sigma[2] = unseen, unseen, unseen
    return replace(
        moved,
        position_px=position,
        covariance_px2=covariance,
        face_start_undistorted_px=start,
        face_end_undistorted_px=end,
        face_sigma_px=sigma,
    )


@pytest.mark.slow
@pytest.mark.parametrize(
    ("distance_m", "end_sigma_px"),
    [
        (0.5, 2.0),
        *(pytest.param(*case, marks=pytest.mark.slow) for case in ((0.25, 0.3), (0.25, 8.0), (0.5, 0.3), (0.5, 8.0))),
    ],
)
def test_a_second_stripe_on_the_background_hardly_ever_gives_a_sure_normal(rng, distance_m, end_sigma_px):
    scene = make_scene("B", distance_m=distance_m)
    wrong = 0
    for _ in range(20):
        shot = two_stripes_one_on_the_background(scene, face_points_of(scene, 0.3, 0.01, rng), rng, end_sigma_px)

        result = pose_result(shot, scene.rig)

        if isinstance(result.pose, RingPose) and not result.flags & (PoseFlag.NORMAL_WEAK | PoseFlag.INCONSISTENT):
            sigma_rad = np.sqrt(np.linalg.eigvalsh(result.pose.covariance[:2, :2])[-1])
            wrong += angle_between(result.pose.normal, scene.ring.normal) > 5.0 * sigma_rad
    assert wrong <= 1  # by chance a stripe on the background looks as on the ring


def test_two_stripes_with_clear_ends_give_a_sure_normal_of_a_known_ring(rng):
    scene = make_scene("B", distance_m=0.25)
    points = with_stripes(face_points_of(scene, 0.3, 0.01, rng), 0, 1)

    pose = estimate_pose(points, scene.rig, known=KNOWN)

    assert not pose.flags & (PoseFlag.NORMAL_WEAK | PoseFlag.GRASP_WEAK)
    assert pose.normal @ scene.ring.normal > np.cos(0.005)
    unknown = estimate_pose(points, scene.rig)  # two stripes alone may be on a straight bar, too
    assert {PoseFlag.NORMAL_WEAK, PoseFlag.GRASP_WEAK} <= set(unknown.flags)
    assert unknown.normal @ scene.ring.normal > np.cos(0.005)


def small_known_ring():
    """A ring of 0.15 m, of which two stripes alone in the dark have several explanations, and its radii."""
    scene = make_scene("B", distance_m=0.4, size=(0.12, 0.15))
    return scene, KnownRadii(radius_m=scene.ring.radius_m, sd_m=np.full(2, 1e-4))


def test_the_radii_show_that_two_stripes_are_on_one_small_ring(rng):
    scene, known = small_known_ring()
    points = with_stripes(face_points_of(scene, 0.3, 0.01, rng), 0, 1)

    result = pose_result(points, scene.rig, known=known)

    assert not result.flags & (PoseFlag.NORMAL_WEAK | PoseFlag.GRASP_WEAK)
    assert result.pose.normal @ scene.ring.normal > np.cos(0.01)
    assert not isinstance(pose_result(points, scene.rig).pose, RingPose)  # without them, one may be on the background


def test_the_radii_do_not_make_a_stripe_on_the_background_one_of_the_ring(rng):
    scene, known = small_known_ring()
    for _ in range(12):
        shot = two_stripes_one_on_the_background(scene, face_points_of(scene, 0.3, 0.01, rng), rng, 2.0)

        result = pose_result(shot, scene.rig, known=known)

        assert not isinstance(result.pose, RingPose) or result.flags & (PoseFlag.NORMAL_WEAK | PoseFlag.INCONSISTENT)


def far_apart():
    """A ring of 0.3 m before a rig whose two stripes cross it at 45 degrees to either side, and its radii."""
    rig = with_changes(read_scene(PRESETS / "sizes-scene.yaml"), {"baseline_m": 0.2}).rig
    scene = make_scene(rig, distance_m=0.5, size=(0.27, 0.30))
    return scene, KnownRadii(radius_m=scene.ring.radius_m, sd_m=np.full(2, 1e-4))


def test_two_stripes_far_apart_on_a_ring_are_on_one_ring(rng):
    scene, known = far_apart()

    for _ in range(4):
        points = with_stripes(face_points_of(scene, 0.3, 0.02, rng), 0, 1)
        pose = estimate_pose(points, scene.rig, known=known)

        assert not pose.flags & (PoseFlag.NORMAL_WEAK | PoseFlag.GRASP_WEAK | PoseFlag.CENTER_WEAK)
        assert sigmas_off(pose, scene) < 5.0


def test_a_stripe_on_the_background_far_from_the_other_one_gives_no_sure_normal(rng):
    scene, known = far_apart()

    for radii in (None, known) * 4:
        shot = two_stripes_one_on_the_background(scene, face_points_of(scene, 0.3, 0.02, rng), rng, 0.3)
        result = pose_result(shot, scene.rig, known=radii)

        assert not isinstance(result.pose, RingPose) or result.flags & (PoseFlag.NORMAL_WEAK | PoseFlag.INCONSISTENT)


def test_a_wrong_stripe_of_a_shot_that_may_move_is_rejected_by_the_detector(rng):
    scene = make_scene("B", distance_m=0.5)
    shift_px = np.array([0.0, 0.0, 40.0])[:, None] * [0.0, 1.0]
    true = face_points_of(scene, 0.2, 0.02, rng)
    points = replace(
        true,
        position_px=true.position_px + shift_px[:, None],
        face_start_undistorted_px=true.face_start_undistorted_px + shift_px,
        face_end_undistorted_px=true.face_end_undistorted_px + shift_px,
        stamp_s=100.0 + 0.033 * np.arange(3),  # that in the middle is exactly their mean
    )

    found = without_outliers(points, scene.rig, Assumptions(motion=motion_prior()))

    assert [(each.what, each.laser) for each in found.rejected] == [("stripe", "right")]


@pytest.mark.parametrize(("sigma_px", "known"), [(0.3, True), (1.0, False), (2.0, False)])
def test_the_edges_of_a_ring_whose_curvature_is_not_significant_are_not_named(sigma_px, known, rng):
    scene = make_scene("B", distance_m=0.2)

    found = without_outliers(face_points_of(scene, sigma_px, 0.1 * sigma_px, rng), scene.rig)

    assert not found.rejected
    flag = 0 if known else int(BreakPointFlag.EDGE_UNKNOWN)
    assert found.break_points.flags.ravel().tolist() == [flag] * 6


def test_stripes_that_a_moving_camera_sees_at_different_times_are_those_of_one_ring(scene):
    times_s = np.array([0.0, 0.5, 1.0])
    seen = SeenByRobot(in_base(Motion(ring=scene.ring, velocity_m_s=np.zeros(3), rate_rad_s=np.zeros(3))))
    rng = np.random.default_rng(3)
    shots = [face_points_of(scene_of(scene.rig, seen.at(time_s)), 0.2, 0.02, rng) for time_s in times_s]
    names = ("position_px", "face_start_undistorted_px", "face_end_undistorted_px")
    own = {name: np.stack([getattr(shot, name)[laser] for laser, shot in enumerate(shots)]) for name in names}
    points = replace(shots[0], **own, stamp_s=START_S + times_s)

    found = without_outliers(points, scene.rig, camera=robot(1.5))

    assert found.ring is not None
    assert not found.rejected
    assert not found.break_points.flags.any()


def test_ends_are_not_rejected_where_the_other_side_of_the_centre_rejects_others():
    """From a rendered shot in the sun: the right stripe goes on by 26 px; the ends of the other side are exchanged."""
    rig = read_scene(PRESETS / "paper-physical-scene.yaml").rig
    start_px = np.array([[803.01, 844.10], [926.14, 465.72], [921.63, 213.40]])
    end_px = np.array([[865.13, 844.35], [979.30, 465.33], [977.00, 213.17]])
    left_px = np.array([[804.00, 843.66], [np.nan, np.nan], [921.39, 215.37]])
    right_px = np.array([[863.41, 843.86], [979.72, 465.55], [1002.76, 215.34]])
    position_px, ends_px = np.stack([left_px, right_px], axis=1), np.stack([start_px, end_px], axis=1)
    seen = np.where(np.isfinite(position_px[..., :1, None]), 1.0, np.nan)
    points = replace(
        with_lines(break_points_of(position_px), ends_px, 0.055), covariance_px2=seen * np.diag([0.1, 0.003])
    )

    found = without_outliers(points, rig, USUAL.about_shot(rig.stability, still=True))

    assert not found.rejected


def test_a_stripe_of_three_is_not_rejected_where_without_another_one_the_shot_passes_the_test_too():
    """From a rendered ring with gaps: the middle stripe lies in one, 12 mm below the face, and not the left one."""
    rig = read_scene(PRESETS / "paper-physical-scene.yaml").rig
    position_px = np.array(
        [
            [[625.2041, 821.5549], [693.9072, 822.3410]],
            [[651.0562, 428.8819], [720.6694, 429.3764]],
            [[629.6344, 191.9437], [702.4003, 191.9838]],
        ]
    )
    ends_px = np.array(
        [
            [[625.5844, 822.0986], [694.8118, 822.7635]],
            [[649.7588, 428.5911], [720.9128, 429.1835]],
            [[627.9899, 189.4819], [701.4821, 189.7490]],
        ]
    )
    sigma_px = np.array([0.0385, 0.0314, 0.0291])
    variance_px2 = np.array([[0.028, 0.0259], [0.0187, 0.0131], [0.0117, 0.012]])[..., None, None]
    points = replace(
        with_lines(break_points_of(position_px), ends_px, sigma_px[:, None]),
        covariance_px2=variance_px2 * np.diag([1.0, 0.06]),
    )

    found = without_outliers(points, rig, USUAL.about_shot(rig.stability, still=True))

    assert not found.rejected
