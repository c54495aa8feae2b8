"""The closed loop: one run is reproducible and succeeds, wrong lines do not close the gripper, studies resume."""

from dataclasses import replace
from math import erf, radians, sqrt

import numpy as np
import pytest
from whole_records import complete_line, complete_track, protection

from ringpose.bench.capture.guidance import MAX_AGE_S, Guidance, GuidedRing, ring_of_pose, ring_of_track
from ringpose.bench.capture.loop import guided_by, run_loop
from ringpose.bench.capture.score import CaptureOutcome, outcome_of, refuted_claims
from ringpose.bench.capture.study import capture_rows, drawn_world, line_of_row
from ringpose.bench.capture.world import tumbling
from ringpose.files.studies.specification import read_study, study_path
from ringpose.geometry.rotations import angle_between, tilt_basis
from ringpose.simulate.motion import FreeAttitude
from ringpose.simulate.robot import Pose
from ringpose.track.lines import capture_probability
from ringpose.types.capture import FloatingBase
from ringpose.types.options import PoseFrame
from ringpose.types.pose import PoseFlag
from ringpose.types.study import CAPTURE_TIMES, StudyMethod, columns
from ringpose.types.target import FreeMotion
from ringpose.types.track import Validity

RUN = 2  # at 3 deg/s


@pytest.fixture(scope="module")
def study():
    """The preset, with a short way to the ring and few shots."""
    preset = read_study(study_path("capture"), count=1, seed=11)
    factors = tuple(
        replace(factor, values=(0.45,)) if factor.name == "distance_m" else factor for factor in preset.factors
    )
    return replace(preset, factors=factors, capture=replace(preset.capture, period_s=0.2))


def exact_ring(world, time_s, noise_m=1e-5, **changes):
    """What a line without errors would state at a time, with small standard deviations."""
    _, ring = world.closed_at(time_s)
    base = world.robot.inertial_from_base(time_s).inverse
    center_m, normal = base.at(ring.center_m), base.rotation @ ring.normal
    tool = world.robot.base_from_tool(time_s) @ world.tool_from_gripper
    across = tool.position_m - center_m
    across = across - (across @ normal) * normal
    radius_m = 0.5 * (ring.radius_inner_m + ring.radius_outer_m)
    exact = GuidedRing(
        stamp_s=time_s,
        measured_s=time_s,
        grasp_m=center_m + radius_m * across / np.linalg.norm(across),
        normal=normal,
        velocity_m_s=np.zeros(3),
        rate_rad_s=np.zeros(3),
        center_m=center_m,
        covariance=noise_m**2 * np.eye(5),
        covariance_s=time_s,
        growth=np.zeros((5, 5)),
        obstacle="",
    )
    return replace(exact, **changes)


def still_world(study):
    """A world in which nothing moves but the robot, whose mount and poses are exact."""
    still = {"target_rate_rad_s": 0.0, "drift_m_s": 0.0, "floating_base": False}
    factors = tuple(
        replace(factor, values=(still[factor.name],)) if factor.name in still else factor for factor in study.factors
    )
    mount = replace(study.scene.rig.mount, root=np.zeros((6, 6)), delay_sd_s=0.0, robot_rotation_sd_rad=0.0)
    mount = replace(mount, robot_translation_sd_m=0.0)
    scene = replace(study.scene, rig=replace(study.scene.rig, mount=mount))
    return drawn_world(replace(study, factors=factors, scene=scene), 0)[0]


def test_a_run_captures_the_ring_and_is_the_same_when_it_is_computed_again(study):
    (row,), (again,) = capture_rows(study, RUN), capture_rows(study, RUN)

    assert row["outcome"] == "success", row
    assert row["capture_probability"] > 0.95
    assert row["radial_error_m"] < 0.002
    assert list(row) == list(columns(study))
    for name in CAPTURE_TIMES:
        del row[name], again[name]
    assert row == again


def test_the_record_of_a_row_has_its_outcome(study):
    (row,) = capture_rows(replace(study, capture=replace(study.capture, timeout_s=1.0)), 0)
    line = line_of_row(row, [factor.name for factor in study.factors])

    assert row["outcome"] == "no closing"
    assert outcome_of(line).outcome is CaptureOutcome.NO_CLOSING
    assert line.reason == "the gripper is not there yet"


def test_exact_lines_lead_the_gripper_to_the_middle_of_the_band(study):
    world = still_world(study)
    run = run_loop(world, lambda number, time_s: exact_ring(world, time_s), latency_s=0.05)
    scored = outcome_of(run.line("r", "exact", {}))

    assert scored.outcome is CaptureOutcome.SUCCESS
    assert scored.radial_m < 4e-4  # the mean jitter of a command, 5 ms, at the highest acceleration along the way
    assert scored.tilt_rad < radians(0.05)


@pytest.mark.parametrize(
    ("changes", "why"),
    [
        ({"obstacle": "no protection level of the normal"}, "normal"),
        ({"covariance": 1e-3**2 * np.eye(5)}, "probability"),
        ({"measured_s": -1.0}, "old"),
        ({"center_m": np.full(3, np.nan)}, "centre"),
    ],
)
def test_a_gripper_in_place_does_not_close_by_a_line_that_cannot_be_trusted(study, changes, why):
    world = still_world(study)
    guidance, ring = Guidance(guided_by(world)), exact_ring(world, 0.0)
    tool = at_the_ring(world, ring)

    assert guidance.step(0.0, 0.03, tool, ring).closes
    decision = Guidance(guided_by(world)).step(0.0, 0.03, tool, replace(ring, **changes))
    assert not decision.closes
    assert why in decision.why


@pytest.mark.parametrize(
    ("levels", "obstacle"),
    [
        (protection(), ""),
        (protection().without(frozenset({"center"})), ""),
        (protection().without(frozenset({"normal"})), "no protection level of the normal"),
        (protection().without(frozenset({"grasp", "normal"})), "no protection level of the grasp point and normal"),
        (replace(protection(), grasp_radial_m=np.inf), "no protection level of the grasp point"),
        (None, "the line has no protection levels"),
    ],
)
def test_a_track_closes_the_gripper_only_by_protection_levels_of_grasp_and_normal(levels, obstacle):
    line = replace(complete_track(np.random.default_rng(3)), validity=Validity.VALID, protection=levels)

    assert ring_of_track(line).obstacle == obstacle
    assert ring_of_track(replace(line, flags=PoseFlag.RIG_DRIFT)).obstacle == obstacle  # levels contain what flags mean


@pytest.mark.parametrize(("method", "obstacle"), [("ml", "the line has no protection levels"), ("paper", "")])
def test_a_method_that_states_no_levels_is_not_held_back_by_their_lack(method, obstacle):
    line = complete_line(np.random.default_rng(4))
    line = replace(line, frame=PoseFrame.BASE, protection=None, pose=replace(line.pose, method=method))

    assert ring_of_pose(line).obstacle == obstacle


def at_the_ring(world, ring):
    """The pose of the tool with which the gripper is on the band."""
    gripper = Pose(
        rotation=np.stack([x := ring.outward(ring.grasp_m), np.cross(-ring.normal, x), -ring.normal], axis=1),
        position_m=ring.grasp_m,
    )
    return gripper @ world.tool_from_gripper.inverse


def test_a_gripper_holds_without_a_ring_and_does_not_come_nearer_by_an_old_one(study):
    world = still_world(study)
    guidance = Guidance(guided_by(world))
    ring, distance_m = exact_ring(world, 0.0), 0.3
    tool = at_the_ring(world, ring)
    tool = replace(tool, position_m=tool.position_m + distance_m * ring.normal)

    assert not guidance.step(0.0, 0.03, tool, None).twist.velocity_m_s.any()
    nearer = guidance.step(0.0, 0.03, tool, ring)
    late = guidance.step(MAX_AGE_S + 0.1, 0.03, tool, ring)
    assert nearer.twist.velocity_m_s @ ring.normal < -0.09
    assert "old" in late.why
    assert abs(late.twist.velocity_m_s @ ring.normal) < 0.02


def test_a_gripper_goes_back_when_nothing_is_measured_and_waits_where_it_began(study):
    world = still_world(study)
    guidance, ring = Guidance(guided_by(world)), exact_ring(world, 0.0)
    tool = at_the_ring(world, ring)

    def at(distance_m, now_s):
        place = replace(tool, position_m=tool.position_m + distance_m * ring.normal)
        return guidance.step(now_s, 0.5, place, ring)

    at(0.1, 0.0)
    at(0.05, 0.4)
    back = at(0.05, 2.0 * MAX_AGE_S + 0.1)
    assert back.twist.velocity_m_s @ ring.normal > 0.05
    assert not back.closes
    at(0.1, 3.5)
    waiting = at(0.15, 4.0)
    assert not waiting.twist.velocity_m_s.any()
    assert "waits" in waiting.why


def test_a_claim_contains_the_reaction_of_a_floating_base_to_an_arm_that_stops(study):
    world = still_world(study)
    fixed, base, ring = guided_by(world), FloatingBase(), exact_ring(world, 0.0, measured_s=1.0)
    tool = at_the_ring(world, ring)
    along = np.cross(ring.normal, ring.outward(ring.grasp_m))
    decisions = {}
    for name, guided in (("fixed", fixed), ("floating", replace(fixed, base=base))):
        guidance = Guidance(guided)
        for tick in range(17):  # at 0.1 m/s until the newest measurement, then at rest
            now_s = 0.7 + 0.03 * tick
            place_m = tool.position_m + min(now_s - 1.0, 0.0) * 0.1 * along
            decisions[name] = guidance.step(now_s, 0.03, replace(tool, position_m=place_m), ring)

    # by then the tool was expected 28 mm further; momenta to first order, the arm's mass as a point at r
    missing_m = -0.1 * (now_s + fixed.closing_s - 1.0) * along
    r, step = base.shoulder_m + base.arm_share * (tool.position_m - base.shoulder_m), base.arm_share * missing_m
    reduced_kg = base.mass_kg * base.arm_mass_kg / (base.mass_kg + base.arm_mass_kg)
    inertia = np.diag(base.inertia_kg_m2) + reduced_kg * (r @ r * np.eye(3) - np.outer(r, r))
    turn_rad = -np.linalg.solve(inertia, reduced_kg * np.cross(r, step))
    share = base.arm_mass_kg / (base.mass_kg + base.arm_mass_kg)
    moved_m = -share * (step + np.cross(turn_rad, r)) + np.cross(turn_rad, ring.grasp_m)
    across_m = np.hypot(moved_m @ ring.outward(ring.grasp_m), moved_m @ ring.normal)

    assert decisions["fixed"].probability > 0.99
    assert across_m > 0.001
    assert decisions["floating"].probability == pytest.approx(erf(0.002 / across_m / sqrt(2.0)), abs=0.02)


def test_the_covariance_at_a_place_beside_the_grasp_point_contains_the_tilt(study):
    ring = exact_ring(still_world(study), 0.0, covariance=np.diag([0, 0, 0, 1e-6, 4e-6]))
    aside_m = 0.01 * np.cross(ring.normal, ring.outward(ring.grasp_m))
    covariance = ring.covariance_at(0.0, ring.grasp_m + aside_m)

    along = tilt_basis(ring.normal) @ aside_m
    assert covariance[1, 1] == pytest.approx(along**2 @ [1e-6, 4e-6])
    assert covariance[0, 0] == pytest.approx(0.0, abs=1e-20)


def test_a_probability_with_an_offset_is_the_share_of_draws():
    rng = np.random.default_rng(5)
    root = np.diag([5e-4, 8e-4, 3e-3, 4e-3]) @ np.array([[1, 0, 0, 0], [0.3, 1, 0, 0], [0, 0, 1, 0], [0, 0.2, 0, 1]])
    offset = np.array([1e-3, -5e-4, 5e-3, 2e-3])
    errors = offset + rng.standard_normal((200_000, 4)) @ root.T
    inside = (np.hypot(errors[:, 0], errors[:, 1]) <= 0.002) & (np.hypot(errors[:, 2], errors[:, 3]) <= radians(1))

    assert capture_probability(root @ root.T, 0.002, radians(1), offset) == pytest.approx(inside.mean(), abs=0.006)
    assert capture_probability(root @ root.T, 0.002, radians(1), np.zeros(4)) == pytest.approx(
        capture_probability(root @ root.T, 0.002, radians(1))
    )


def test_a_symmetric_target_nutates_at_the_angle_and_the_rate_that_are_given():
    # of an axisymmetric body the angle between axis and momentum is constant, and the axis goes round at |L| / I_t
    free = FreeMotion(inertia_kg_m2=np.diag([3.0, 3.0, 2.0]), center_of_mass_m=np.zeros(3),
                      angular_velocity_rad_s=np.zeros(3))  # fmt: skip
    motion = tumbling(free, radians(8.0), radians(10.0), 0.01, np.random.default_rng(2))
    momentum = free.inertia_kg_m2 @ motion.angular_velocity_rad_s
    attitude = FreeAttitude(free.inertia_kg_m2, motion.angular_velocity_rad_s, 30.0)

    assert np.linalg.norm(motion.angular_velocity_rad_s) == pytest.approx(radians(8.0))
    assert np.linalg.norm(motion.velocity_m_s) == pytest.approx(0.01)
    momentum *= np.sign(momentum[2])
    axes = np.array([attitude.at(time_s)[0][:, 2] for time_s in (0.0, 7.0, 30.0)])
    np.testing.assert_allclose(angle_between(axes, np.tile(momentum, (3, 1))), radians(10.0), rtol=1e-9)
    unit = momentum / np.linalg.norm(momentum)
    across = axes - (axes @ unit)[:, None] * unit
    turned = angle_between(across[0], across[1])
    assert turned == pytest.approx(np.linalg.norm(momentum) / 3.0 * 7.0, rel=1e-9)


@pytest.mark.parametrize("method", [StudyMethod.ML, StudyMethod.PAPER, StudyMethod.POINTS])
def test_every_baseline_can_guide_a_gripper(study, method):
    loop = replace(study.capture, timeout_s=1.5)
    (row,) = capture_rows(replace(study, methods=(method,), capture=loop), RUN)

    assert row["outcome"] == "no closing", row["reason"]
    assert 5 <= row["shots"] <= 8  # some are lost
    assert row["rings"] > 2


@pytest.mark.slow
def test_the_form_of_the_ring_in_many_shots_of_one_arc_is_no_moved_light_plane():
    (row,) = capture_rows(read_study(study_path("capture-lights"), count=50), 105)

    # with a form that counted as another one in each shot, a plane was corrected by 0.3 mm, and it closed 1.3 deg off
    assert row["outcome"] == "success"
    assert row["tilt_error_rad"] < radians(0.5)


@pytest.mark.slow
def test_the_preset_captures_at_every_rate():
    preset = read_study(study_path("capture"), count=2, seed=21)
    rows = [row for index in range(preset.shots) for row in capture_rows(preset, index)]
    lines = [line_of_row(row, [factor.name for factor in preset.factors]) for row in rows]

    # of eight runs of which each succeeds with 95 %, six or fewer do with a probability of 6 %, five with 0.6 %
    assert sum(row["outcome"] == "success" for row in rows) >= 6, [(row["outcome"], row["reason"]) for row in rows]
    assert not refuted_claims(lines)
