"""One run of the closed loop: shots, their lines, the guidance and the robot, until the gripper closes or time is out.

A line is used when its latency has passed. Poses of the robot that a line needs are those that it has reported until
the end of the shot.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from math import inf, nan

from ringpose.bench.capture.guidance import Decision, Guidance, Guided, GuidedRing
from ringpose.bench.capture.world import World
from ringpose.simulate.robot import Pose
from ringpose.track.explanations import Gripper
from ringpose.types.capture import CaptureLine, GripperState, TrueRing

TICKS = 4
"""Ticks of the controller in the time between two shots."""

SAME_S = 1e-9
"""Difference of two times, by rounding, up to which they are the same."""

Measure = Callable[[int, float], GuidedRing | None]
"""Takes the shot of this number, at this time, and returns what its line states about the ring."""


@dataclass(slots=True)
class Run:
    """What has happened in a run."""

    closed_s: float = nan
    decision: Decision = field(default_factory=Decision)
    """The decision to close, or the last one."""
    shots: int = 0
    rings: int = 0
    """Shots whose line had a ring that could be followed."""
    state: tuple[GripperState, TrueRing] | None = None

    def line(self, run: str, method: str, groups: Mapping[str, str | float | int | bool]) -> CaptureLine:
        """The record of the run."""
        gripper, ring = (None, None) if self.state is None else self.state
        probability = self.decision.probability
        return CaptureLine(
            run=run,
            method=method,
            groups=groups,
            closed_s=self.closed_s,
            reason="" if self.state is not None else self.decision.why,
            gripper=gripper,
            ring=ring,
            capture_probability=probability if self.state is not None and probability == probability else None,
        )


def run_loop(world: World, measure: Measure, latency_s: float, lost: Callable[[int], bool] = lambda _: False) -> Run:
    """Run the loop of a world; `lost`: which shots are not taken."""
    loop, run = world.loop, Run()
    guidance, tick_s = Guidance(guided_by(world)), loop.period_s / TICKS
    pending: list[tuple[float, GuidedRing | None]] = []
    ring: GuidedRing | None = None
    meets_s = inf
    for tick in range(round(loop.timeout_s / tick_s)):
        now_s = tick * tick_s
        if now_s >= meets_s - SAME_S:
            break
        while pending and pending[0][0] <= now_s:
            ring = pending.pop(0)[1] or ring
        decision = guidance.step(now_s, tick_s, _tool_now(world, now_s), ring)
        world.robot.command(now_s, decision.twist)
        if meets_s == inf:  # the fingers cannot be stopped
            run.decision = decision
            meets_s = now_s + loop.closing_s if decision.closes else inf
        if tick % TICKS == 0 and not lost(tick // TICKS):
            seen = measure(tick // TICKS, now_s)
            run.shots, run.rings = run.shots + 1, run.rings + (seen is not None)
            pending.append((now_s + latency_s, seen))
        world.advance(max(now_s + tick_s, world.robot.now_s))
    if meets_s < inf:
        world.advance(meets_s)
        run.closed_s, run.state = meets_s, world.closed_at(meets_s)
    return run


def guided_by(world: World) -> Guided:
    """What the guidance knows of the robot of a world."""
    loop, mount = world.loop, world.mount
    return Guided(
        gripper=Gripper(radial_m=loop.radial_m, tilt_rad=loop.tilt_rad),
        tool_from_gripper=world.tool_from_gripper,
        delay_s=loop.arm.delay_s + 0.5 * loop.arm.jitter_s,
        closing_s=loop.closing_s,
        min_probability=loop.min_probability,
        base=world.robot.base,
        position_sd_m=mount.robot_translation_sd_m,
        rotation_sd_rad=mount.robot_rotation_sd_rad,
    )


def _tool_now(world: World, now_s: float) -> Pose:
    """The newest pose that the robot has reported by now, by its own stamps."""
    known = [pose for stamp_s, pose in world.reported[-16:] if stamp_s <= now_s + SAME_S]
    return known[-1] if known else world.reported[0][1]
