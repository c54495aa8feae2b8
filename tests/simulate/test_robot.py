"""The robot model: limits, delay, and the reaction of a free-floating base against closed forms and conservation."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from ringpose.geometry.ring import rotation_by
from ringpose.geometry.rotations import rotation_vector
from ringpose.simulate.robot import Pose, Robot, Twist, arm_center_m, reacted
from ringpose.types.capture import Arm, FloatingBase

QUICK = Arm(speed_m_s=1.0, rate_rad_s=1.0, acceleration_m_s2=50.0, angular_acceleration_rad_s2=50.0, jitter_s=0.0)


def robot_at(position_m, arm=QUICK, base=None):
    return Robot(arm, Pose(position_m=np.array(position_m)), np.random.default_rng(1), base)


def test_a_command_takes_effect_after_the_delay_and_within_the_limits():
    arm = Arm(speed_m_s=0.1, acceleration_m_s2=0.2, delay_s=0.05, jitter_s=0.0)
    robot = robot_at([0.0, 0.0, 0.0], arm)
    robot.command(0.0, Twist(velocity_m_s=np.array([1.0, 0.0, 0.0])))
    robot.advance(1.05)

    assert abs(robot.base_from_tool(0.05).position_m[0]) < 1e-12
    # half a second to the highest speed, then that speed; steps of 5 ms begin with the speed at their end
    assert robot.base_from_tool(1.05).position_m[0] == pytest.approx(0.1 * 0.25 + 0.1 * 0.5, abs=0.1 * 0.005)
    moved_m = robot.base_from_tool(1.05).position_m[0] - robot.base_from_tool(1.0).position_m[0]
    assert moved_m == pytest.approx(0.1 * 0.05, rel=1e-6)


def test_commands_are_late_by_the_jitter_at_most_and_keep_their_order():
    robot = robot_at([0.0, 0.0, 0.0], replace(QUICK, jitter_s=0.2))
    for number in range(20):
        robot.command(0.01 * number, Twist(velocity_m_s=np.array([float(number), 0.0, 0.0])))
    due_s = [due_s for due_s, _ in robot._commands]

    assert due_s == sorted(due_s)
    assert due_s[-1] <= 0.19 + 0.05 + 0.2


def test_a_base_moves_against_the_arm_by_the_share_of_its_mass():
    # along the line through both centres of mass nothing turns: M p + m (p + r) is constant
    base = FloatingBase(mass_kg=90.0, arm_mass_kg=10.0, arm_share=1.0, shoulder_m=np.zeros(3))
    robot = robot_at([1.0, 0.0, 0.0], base=base)
    robot.command(0.0, Twist(velocity_m_s=np.array([0.5, 0.0, 0.0])))
    robot.advance(2.0)
    moved_m = robot.base_from_tool(2.0).position_m[0] - 1.0

    np.testing.assert_allclose(robot.inertial_from_base(2.0).position_m, [-0.1 * moved_m, 0.0, 0.0], atol=1e-12)
    np.testing.assert_allclose(robot.inertial_from_base(2.0).rotation, np.eye(3), atol=1e-12)


def test_an_arm_that_goes_round_turns_the_base_by_the_closed_form():
    # in a circle about the base's centre of mass: I w + mu r^2 (w + p') = 0
    base = FloatingBase(
        mass_kg=40.0, arm_mass_kg=10.0, arm_share=1.0, shoulder_m=np.zeros(3), inertia_kg_m2=np.array([5.0, 6.0, 7.0])
    )
    radius_m, steps, reduced_kg = 0.8, 4000, 40.0 * 10.0 / 50.0
    places = radius_m * np.stack([np.cos(a := np.linspace(0, np.pi / 2, steps + 1)), np.sin(a), 0 * a], axis=1)
    pose, turned_rad = Pose(), 0.0
    for before_m, after_m in pairwise(places):
        later = reacted(base, pose, before_m, after_m)
        turned_rad += rotation_vector(pose.rotation.T @ later.rotation)[2]
        pose = later

    expected_rad = -reduced_kg * radius_m**2 / (7.0 + reduced_kg * radius_m**2) * np.pi / 2
    assert turned_rad == pytest.approx(expected_rad, rel=1e-6)


def test_momenta_of_base_and_arm_stay_zero():
    base = FloatingBase()
    rng = np.random.default_rng(3)
    robot = robot_at([1.2, 0.3, -0.2], replace(QUICK, acceleration_m_s2=0.5, angular_acceleration_rad_s2=0.5), base)
    for number in range(40):
        robot.command(0.1 * number, Twist(velocity_m_s=0.3 * rng.standard_normal(3), rate_rad_s=rng.standard_normal(3)))
        robot.advance(0.1 * (number + 1))

    def masses_m(time_s):
        pose, tool = robot.inertial_from_base(time_s), robot.base_from_tool(time_s)
        return pose, pose.at(arm_center_m(base, tool.position_m))

    def momenta(time_s, half_s=1e-4):
        (before, arm_before_m), (after, arm_after_m) = masses_m(time_s - half_s), masses_m(time_s + half_s)
        pose, arm_m = masses_m(time_s)
        base_m_s = (after.position_m - before.position_m) / (2 * half_s)
        arm_m_s = (arm_after_m - arm_before_m) / (2 * half_s)
        rate = rotation_vector(after.rotation @ before.rotation.T) / (2 * half_s)
        spin = pose.rotation @ np.diag(base.inertia_kg_m2) @ pose.rotation.T @ rate
        of_base = base.mass_kg * np.cross(pose.position_m, base_m_s)
        linear = base.mass_kg * base_m_s + base.arm_mass_kg * arm_m_s
        return linear, spin + of_base + base.arm_mass_kg * np.cross(arm_m, arm_m_s), spin

    for time_s in (0.5025, 1.7025, 3.9025):  # in the middle of a step
        linear, angular, spin = momenta(time_s)
        assert np.abs(linear).max() < 1e-6 * base.arm_mass_kg  # against some kg m/s of the arm alone
        assert np.abs(angular).max() < 1e-2 * np.abs(spin).max()  # the pose is interpolated within a step
    assert np.linalg.norm(robot.inertial_from_base(4.0).position_m) > 1e-3


def test_a_robot_without_a_floating_base_leaves_it_where_it_is():
    robot = robot_at([1.0, 0.0, 0.0])
    robot.command(0.0, Twist(velocity_m_s=np.array([0.5, 0.2, 0.0])))
    robot.advance(1.0)

    assert not robot.inertial_from_base(1.0).position_m.any()
    np.testing.assert_array_equal(robot.inertial_from_tool(1.0).position_m, robot.base_from_tool(1.0).position_m)


def test_poses_between_steps_are_interpolated_and_transforms_invert():
    turn = rotation_by(np.array([0.1, -0.4, 0.3]))
    pose = Pose(rotation=turn, position_m=np.array([1.0, 2.0, 3.0]))
    there = pose @ pose.inverse

    np.testing.assert_allclose(there.matrix, np.eye(4), atol=1e-14)
    half = Pose().towards(Pose(rotation=turn, position_m=pose.position_m), 0.5)
    np.testing.assert_allclose(half.rotation @ half.rotation, turn, atol=1e-12)
