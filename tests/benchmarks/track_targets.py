"""Accuracy and consistency of `ringpose track` against its targets: `make bench-targets`.

Records of rings in known motion (`tests/moving_rings.py`: shots `off,1,2,3,off` at 30 frames a second, rig B, break
points 0.3 px, lines 0.02 px, in the dark, radius unknown) are tracked, and errors are compared with the truth. One line
a target: figure, limit, and whether it is reached. `--runs` sets the number of independent runs of each.
"""

import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import cv2
import numpy as np
from benchmarks.limits import WRONG_SIGMAS, Figure, band, options, status, target
from moving_cameras import SeenByRobot, in_base, robot
from moving_rings import (
    START_S,
    Motion,
    Pushed,
    Shots,
    Wandering,
    drawn_motion,
    grasp_distance_m,
    measured,
    record,
    stream,
)
from ring_scenes import RIGS, pixels_of
from scipy.stats import binom, chi2
from tracked_rings import DEGREES_OF_FREEDOM, errors_at, nees_at, newest, track_of

from ringpose.geometry.ring import normal_and_center
from ringpose.geometry.rotations import angle_between, tilt_basis
from ringpose.track.common_errors import common_errors
from ringpose.track.explanations import Gripper, TrackOptions
from ringpose.track.filters import predict, predict_and_update
from ringpose.track.observation import observation
from ringpose.track.pipeline import Tracker
from ringpose.types.assumptions import MotionPrior, RigStability
from ringpose.types.pose import PoseFlag, PoseLine
from ringpose.types.track import FusionStatus, MotionModel, TrackLine

SHOTS_HZ = 6.0
SPEED_M_S, RATE_DEG_S = 0.01, 0.5
"""Standard deviations per axis of the motion of a typical dead satellite."""


def motions(rng, runs: int, **drawn) -> Iterator[Motion]:
    """Slow motions at 0.3 to 0.7 m."""
    for _ in range(runs):
        yield drawn_motion(rng, rng.uniform(0.3, 0.7), **{"speed_m_s": SPEED_M_S, "rate_deg_s": RATE_DEG_S, **drawn})


def add_nees(found: dict, motion, line, *key) -> None:
    """The NEES of each quantity of a line, by its name and the key; none of a line without a centre."""
    for name, value in nees_at(motion, line).items():
        found.setdefault((name, *key), []).append(value)


def nees_figures(found: dict, runs: int, where: str, two_sided=lambda name, *key: False) -> Iterator[Figure]:
    """The mean of each NEES in its band; `where` is a format of the key, of which `two_sided` have a lower limit."""
    for (name, *key), values in found.items():
        least, most = band(min(len(values), runs), DEGREES_OF_FREEDOM[name])
        least = least if two_sided(name, *key) else -np.inf
        yield target(f"NEES of {name}, {where.format(*key)}", np.mean(values), most, least)


def single_still_shot(rng, runs: int) -> tuple[float, float]:
    """Standard deviations of centre and normal of one shot of a still target, root mean square over the distances."""
    squares = []
    for motion in motions(rng, runs, speed_m_s=0.0, rate_deg_s=0.0):
        found = measured(motion, 0.0, Shots(), None)[0]
        covariance = np.linalg.inv(found.square_root[:, :7].T @ found.square_root[:, :7])
        _, center_wrt = normal_and_center(found.linearized_at.normal, found.linearized_at.center_m)
        center = center_wrt @ covariance[:5, :5] @ center_wrt.T
        squares.append([np.trace(center), np.trace(covariance[:2, :2])])
    center_m, normal_rad = np.sqrt(np.mean(squares, axis=0)).tolist()
    return center_m, normal_rad


def steady(rng, runs: int) -> Iterator[Figure]:
    """A target of constant velocity: gain over single shots, consistency of predictions."""
    center_m, normal_rad = single_still_shot(rng, runs)
    found: dict[tuple[str, float, float], list[float]] = {}
    squares: dict[tuple[str, float, float], list[float]] = {}
    for motion in motions(rng, runs):
        tracker = Tracker(None)
        for number, line in enumerate(stream(motion, 5.0 + 1 / SHOTS_HZ, Shots(), rng, SHOTS_HZ)):
            tracker.add(line)
            if number not in (SHOTS_HZ, 5 * SHOTS_HZ):
                continue
            for ahead_s in (0.0, 0.1, 0.5, 2.0):
                at = newest(tracker, ahead_s)
                add_nees(found, motion, at, number / SHOTS_HZ, ahead_s)
                for name, (error, _) in errors_at(motion, at).items():
                    squares.setdefault((name, number / SHOTS_HZ, ahead_s), []).append(float(error @ error))
    for name, time_s, single, most in (
        ("normal", 1.0, normal_rad, 0.8),
        ("normal", 5.0, normal_rad, 0.4),
        ("centre", 5.0, center_m, 0.35),
    ):
        ratio = np.sqrt(np.mean(squares[name, time_s, 0.0])) / single
        yield target(f"{name} after {time_s:.0f} s, by that of a single still shot", ratio, most)
    yield from nees_figures(found, runs, "constant velocity, {:.0f} s of track, {:g} s ahead")


def wandering(rng, runs: int) -> Iterator[Figure]:
    """Truth drawn from the filter's model."""
    for noise in ((1e-6, 1e-6), (1e-4, 1e-4)):
        found: dict[tuple[str, float], list[float]] = {}
        for motion in motions(rng, runs):
            truth = Wandering(motion, noise, 7.5, rng)
            tracker = track_of(stream(truth, 5.0, Shots(), rng, SHOTS_HZ))
            for ahead_s in (0.1, 0.5, 2.0):
                add_nees(found, truth, newest(tracker, ahead_s), ahead_s)
        where = f"process noise {noise[0]:g}, 5 s of track, {{:g}} s ahead"
        yield from nees_figures(found, runs, where, lambda *_: True)


def rig_errors(rng, runs: int) -> Iterator[Figure]:
    """Light planes drawn from the stability that the records state."""
    stability = RigStability(plane_tilt_rad=1e-4, plane_distance_m=2e-5)
    sds = {"tilt_1": 1e-4, "tilt_2": 1e-4, "distance": 2e-5}
    found: dict[str, list[float]] = {}
    for motion in motions(rng, runs):
        offsets = {f"{laser}.{what}": sd * rng.normal() for laser in RIGS["B"].lasers.names for what, sd in sds.items()}
        tracker = track_of(stream(motion, 3.0, Shots(stability=stability, offsets=offsets), rng, SHOTS_HZ))
        add_nees(found, motion, tracker.line_at(0.0))
    # constant velocity: the models' process noise widens the covariance of the velocity
    yield from nees_figures(found, runs, "rig errors, 3 s of track", lambda name: name != "velocity")


def robot_poses(rng, runs: int) -> Iterator[Figure]:
    """A camera on a robot whose mount and clock have errors drawn from what the mount states, 3 s of track."""
    mount_sd, delay_sd_s = (0.002, 0.001), 0.01  # rad and m; the camera turns by 3 degrees a second
    known, found = robot(3.5, mount_sd, delay_sd_s), {}
    for motion in motions(rng, runs):
        truth = in_base(motion)
        turn_rad, shift_m = mount_sd[0] * rng.normal(size=3), mount_sd[1] * rng.normal(size=3)
        seen = SeenByRobot(truth, turn_rad, shift_m, delay_sd_s * rng.normal())
        tracker = track_of(stream(seen, 3.0, Shots(), rng, SHOTS_HZ), camera=known)
        for ahead_s in (0.0, 0.5):
            add_nees(found, truth, newest(tracker, ahead_s), ahead_s)
    # constant velocity: the models' process noise widens the covariance of velocities and predictions
    where = "mount and clock drawn, 3 s of track, {:g} s ahead"
    yield from nees_figures(found, runs, where, lambda name, ahead_s: name != "velocity" and not ahead_s)


def precession(rng, runs: int) -> Iterator[Figure]:
    """5 degrees a second with a half-cone of 20 degrees about a centre of mass 1 m behind the ring, 10 s of track."""
    prior = TrackOptions(motion=MotionPrior(speed_sd_m_s=0.05, rate_sd_rad_s=np.deg2rad(2.5)))
    errors, chosen = [], []
    for _ in range(runs):
        first = drawn_motion(rng, 0.5, speed_m_s=0.005, rate_deg_s=0.0)
        axis, turn = rng.normal(size=2) @ tilt_basis(first.ring.normal), np.deg2rad(20.0)
        momentum = cv2.Rodrigues(turn * axis / np.linalg.norm(axis))[0] @ first.ring.normal
        body = replace(first, rate_rad_s=rng.choice([-1, 1]) * np.deg2rad(5.0) * momentum, lever_m=1.0)
        motion = _Shifted(body, 6.0)  # the drawn pose is in the middle of the track
        tracker = track_of(stream(motion, 10.0, Shots(), rng, SHOTS_HZ), prior)
        stamp_s = tracker.track.stamp_s + 2.0
        ring, bank = motion.at(stamp_s - START_S), tracker.track.likeliest
        states = predict(bank, stamp_s).states
        apart = np.linalg.norm(states.center_m - ring.center_m, axis=1) ** 2
        turned = angle_between(states.axes[:, 2], ring.normal) ** 2
        line = tracker.line_at(stamp_s)
        errors.append([apart, turned])
        chosen.append(line.model is MotionModel.PRECESSION)
    mean = np.sqrt(np.mean(errors, axis=0))
    kinds = bank.models.precession
    for name, row in zip(("centre", "normal"), mean, strict=True):
        ratio = row[kinds].min() / row[~kinds].min()
        yield target(f"2 s prediction of {name}: best precession by best constant velocity", ratio, 0.5)
    yield target("share of tracks whose evidence prefers precession", float(np.mean(chosen)), 1, 0.9)


@dataclass(frozen=True)
class _Shifted:
    motion: Motion
    offset_s: float

    def at(self, time_s: float):
        return self.motion.at(time_s - self.offset_s)

    def velocity_at(self, time_s: float):
        return self.motion.velocity_at(time_s - self.offset_s)


def relays(rng, runs: int) -> Iterator[Figure]:
    """Ten frames a second, as with relay boards: two shots a second, motions as in `steady` and `wandering`."""
    found: dict[tuple[str, str, float], list[float]] = {}
    for motion in motions(rng, runs):
        noise = (1e-6, 1e-6)
        for kind, truth in (("constant velocity", motion), ("wandering", Wandering(motion, noise, 7.5, rng))):
            tracker = track_of(stream(truth, 5.0, Shots(frame_s=0.1), rng, 2.0))
            for ahead_s in (0.0, 0.5, 2.0):
                add_nees(found, truth, newest(tracker, ahead_s), kind, ahead_s)
    where = "10 frames/s, {}, 5 s of track, {:g} s ahead"
    yield from nees_figures(found, runs, where, lambda name, kind, ahead_s: kind == "wandering")


def tumbling(rng, runs: int) -> Iterator[Figure]:
    """1 to 8 degrees a second about an axis 30 degrees from the ring's, 1 m behind it, drifting at up to 100 mm/s."""
    prior = MotionPrior(speed_sd_m_s=0.1, rate_sd_rad_s=np.deg2rad(4.0))
    for rate_deg_s in (1.0, 2.67, 8.0):
        found: dict[tuple[str, float], list[float]] = {}
        records, rejected = 0, 0
        for motion in motions(rng, runs, speed_m_s=0.0, rate_deg_s=0.0):
            truth, tracker = _tumbling(motion, rate_deg_s, rng), Tracker(None, TrackOptions(motion=prior))
            lines = _lines_in_view(truth, Shots(motion=prior), rng)
            for number, line in enumerate(lines):
                records += 1
                rejected += tracker.add(line).fusion_status is FusionStatus.REJECTED_GATE
                for ahead_s in (0.0, 0.5) if number in (2, 6, 17) else ():
                    add_nees(found, truth, newest(tracker, ahead_s), ahead_s)
        where = f"{rate_deg_s:g} deg/s, 30 degrees of nutation"
        count, beyond, limit = wrong_quantities(found)
        yield target(f"quantities beyond 5 sigma of {count}, {where}", beyond, limit)
        yield target(f"share of shots rejected, {where}", rejected / records, 0.01)
        yield from nees_figures(found, runs, where + ", {:g} s ahead")


def wrong_quantities(found: dict) -> tuple[int, int, float]:
    """Number of quantities, of those beyond 5 sigma, and of those that chance allows."""
    squares = [DEGREES_OF_FREEDOM[name] * value for (name, *_), values in found.items() for value in values]
    limit = float(binom.ppf(0.99, len(squares), chi2.sf(WRONG_SIGMAS**2, 3)))
    return len(squares), sum(value > WRONG_SIGMAS**2 for value in squares), limit


def _tumbling(motion: Motion, rate_deg_s: float, rng) -> Motion:
    axis, turn = rng.normal(size=2) @ tilt_basis(motion.ring.normal), np.deg2rad(30.0)
    momentum = cv2.Rodrigues(turn * axis / np.linalg.norm(axis))[0] @ motion.ring.normal
    drift = rng.normal(size=3)
    drift *= rng.uniform(0.0, 0.1) / np.linalg.norm(drift)
    spin = rng.choice([-1, 1]) * np.deg2rad(rate_deg_s) * momentum
    return replace(motion, velocity_m_s=drift, rate_rad_s=spin, lever_m=1.0)


def _lines_in_view(truth: Motion, shots: Shots, rng) -> Iterator[PoseLine]:
    """Records of 3 s, until a break point leaves the image."""
    camera = RIGS["B"].camera
    for number in range(int(3.0 * SHOTS_HZ)):
        for time_s in (number / SHOTS_HZ, number / SHOTS_HZ + 0.15):
            pixels = pixels_of(truth.at(time_s).break_points_m(RIGS["B"].lasers), camera)
            if not ((pixels > 0) & (pixels < [camera.image_width, camera.image_height])).all():
                return
        yield record(truth, number / SHOTS_HZ, shots, rng)


def pushed(rng, runs: int) -> Iterator[Figure]:
    """A steady target that is pushed after 3 s: from the third shot on, errors are described again, or flagged."""
    for change_m_s, change_deg_s in ((0.005, 0.0), (0.02, 0.0), (0.1, 0.0), (0.0, 1.0), (0.0, 5.0), (0.02, 1.0)):
        found: dict[tuple[str, float], list[float]] = {}
        flagged = 0
        for motion in motions(rng, runs):
            along, across = rng.normal(size=3), rng.normal(size=2) @ tilt_basis(motion.ring.normal)
            change_rad_s = np.deg2rad(change_deg_s) * across / np.linalg.norm(across)
            push_s = 3.0 + rng.uniform(0.0, 1.0 / SHOTS_HZ)
            truth = Pushed(motion, push_s, change_m_s * along / np.linalg.norm(along), change_rad_s)
            for stamp_s, tracker in _tracked(stream(truth, 5.0, Shots(), rng, SHOTS_HZ), push_s + 2.0 / SHOTS_HZ):
                flagged += bool(tracker.track.rejections)
                for ahead_s in (0.0, 0.5):
                    at = tracker.line_at(stamp_s + ahead_s)
                    if PoseFlag.INCONSISTENT not in at.flags:
                        add_nees(found, truth, at, ahead_s)
        where = f"pushed by {1e3 * change_m_s:g} mm/s and {change_deg_s:g} deg/s"
        count, beyond, limit = wrong_quantities(found)
        yield target(f"quantities beyond 5 sigma without flag of {count}, {where}", beyond, limit)
        yield target(f"later shots with the flag in a run, {where}", flagged / runs, 0.5)
        yield from nees_figures(found, runs, where + ", {:g} s ahead")


def _tracked(lines: list[PoseLine], from_s: float) -> Iterator[tuple[float, Tracker]]:
    """A track of the records after each one from a time on, and the record's stamp."""
    tracker = Tracker(None)
    for line in lines:
        attempt = tracker.add(line)
        if attempt.stamp_s >= START_S + from_s:
            yield attempt.stamp_s, tracker


def outliers(rng, runs: int) -> Iterator[Figure]:
    """Poses that are displaced by some standard deviations of their innovation, after 2 s of track."""
    rejected: dict[float, list[bool]] = {0.0: [], 6.0: [], 9.0: []}
    for motion in motions(rng, runs):
        tracker = Tracker(None)
        for number, line in enumerate(stream(motion, 3.0, Shots(), rng, SHOTS_HZ)):
            if number >= 2.0 * SHOTS_HZ:
                for sigmas, found in rejected.items():
                    twin = Tracker(None)
                    twin._base, twin._common = tracker.track, tracker._common
                    attempt = twin.add(_displaced(line, tracker, sigmas, rng))
                    found.append(attempt.fusion_status is FusionStatus.REJECTED_GATE)
            tracker.add(line)
    share = {sigmas: float(np.mean(found)) for sigmas, found in rejected.items()}
    yield target("share rejected of poses offset by 9 innovation sigmas", share[9.0], 1.0, 1.0)
    yield target("share rejected of poses offset by 6 innovation sigmas", share[6.0], 1.0, 0.85)
    yield target("share rejected of undisturbed poses", share[0.0], 0.003)


def _displaced(line, tracker: Tracker, sigmas: float, rng):
    """The record with centre and normal displaced in a random direction."""
    observed = observation(line, line.measurement, common_errors(line, line.measurement, None), 1.0)
    bank = tracker.track.likeliest
    covariance = predict_and_update(bank, observed)[1].covariance[bank.best]
    direction = np.concatenate([rng.normal(size=5) * np.array([0.01, 0.01, 1e-3, 0.01, 0.01]), np.zeros(7)])
    rows = line.measurement.square_root[:, :12] @ direction
    shift = sigmas / np.sqrt(rows @ np.linalg.solve(covariance, rows)) * direction
    root = line.measurement.square_root.copy()
    root[:, -1] += root[:, :12] @ shift
    return replace(line, measurement=replace(line.measurement, square_root=root))


def sides(rng, runs: int) -> Iterator[Figure]:
    """Rig A in the dark at 0.5 m, tumbling at 5 degrees a second."""
    prior = TrackOptions(motion=MotionPrior(speed_sd_m_s=0.05, rate_sd_rad_s=np.deg2rad(4.0)))
    resolved, wrong = [], 0
    for _ in range(runs):
        first = drawn_motion(rng, 0.5, speed_m_s=0.01, rate_deg_s=0.0, rig="A", side=rng.choice([-1, 1]))
        axis = rng.normal(size=2) @ tilt_basis(first.ring.normal)
        motion = replace(first, rate_rad_s=np.deg2rad(5.0) * axis / np.linalg.norm(axis))
        tracker, known_s = Tracker(None, prior), np.inf
        for number in range(int(3 * SHOTS_HZ) + 1):
            tracker.add(record(motion, number / SHOTS_HZ, Shots(rig="A"), rng))
            track = tracker.track
            if track.weights.max() <= 0.999:
                continue
            known_s = min(known_s, number / SHOTS_HZ)
            inward = track.likeliest.chart.axes[0, 0]
            ring = motion.at(track.stamp_s - START_S)
            wrong += bool(inward @ (ring.center_m - track.likeliest.chart.origin[0]) < 0)
        resolved.append(known_s <= 3.0)
    yield target("rig A: share of tracks whose side is known within 3 s", float(np.mean(resolved)), 1, 0.95)
    yield target("rig A: wrong sides with a weight over 0.999", float(wrong), 0.0)


def capture(rng, runs: int) -> Iterator[Figure]:
    """Outcomes by reported probability: the gripper closes at the reported point, along the reported normal.

    Motions are drawn from the prior of a track, which matters for short ones.
    """
    prior, wanted = TrackOptions().motion, 10 * runs
    drawn = {"speed_m_s": prior.speed_sd_m_s, "rate_deg_s": float(np.degrees(prior.rate_sd_rad_s))}
    outcomes: list[list[tuple[float, bool]]] = [[] for _ in range(10)]
    for motion in motions(rng, 30 * wanted, **drawn):
        tracker = track_of(stream(motion, rng.integers(2, 5) / SHOTS_HZ, Shots(), rng, SHOTS_HZ))
        gripper = _gripper(tracker.line_at(0.0), rng)
        tracker.options = TrackOptions(gripper=gripper)
        found = tracker.line_at(0.0)
        ring, reported = motion.at(found.stamp_s - START_S), found.capture_probability
        tilt = float(angle_between(found.pose.normal, ring.normal))
        captured = grasp_distance_m(found.grasp.point_m, ring) <= gripper.radial_m and tilt <= gripper.tilt_rad
        outcomes[min(int(10 * reported), 9)].append((reported, captured))
        if min(map(len, outcomes)) >= wanted:
            break
    inside, beyond = 0, 0
    for each in outcomes:
        expected, count = np.mean([reported for reported, _ in each[:wanted]]), sum(hit for _, hit in each[:wanted])
        low, least, most, high = binom.ppf([5e-5, 0.005, 0.995, 1 - 5e-5], len(each[:wanted]), expected)
        inside += least <= count <= most
        beyond += not low <= count <= high
    fewest = min(min(map(len, outcomes)), wanted)
    yield target("capture probability: outcomes in each bin", fewest, wanted, wanted)
    yield target("capture probability: bins in their 99 % band, of 10", float(inside), 10, 9)
    yield target("capture probability: bins beyond 99.99 %", float(beyond), 0)


def _gripper(line: TrackLine, rng) -> Gripper:
    """Limits whose probability is nearly uniform, if the errors were isotropic: its share of each limit is drawn."""
    probability, share = rng.uniform(), rng.uniform(0.2, 0.8)
    of_grasp, of_tilt = np.sqrt(chi2.ppf([probability**share, probability ** (1.0 - share)], 2))
    axial = line.pose.normal @ line.grasp.covariance[:3, :3] @ line.pose.normal
    radial = np.trace(line.grasp.covariance[:3, :3]) / 2.0
    sd_m, sd_rad = np.sqrt([(axial + radial) / 2.0, np.trace(line.pose.covariance[:2, :2]) / 2.0])
    return Gripper(radial_m=of_grasp * sd_m, tilt_rad=of_tilt * sd_rad)


_IN_ORDER: tuple[Callable[..., Iterator[Figure]], ...] = (
    steady, wandering, relays, tumbling, rig_errors, robot_poses, precession, pushed, outliers, sides, capture,
)  # fmt: skip

TARGETS = {each.__name__: each for each in _IN_ORDER}


def main() -> int:
    parser = options(__doc__, runs=100)
    parser.add_argument("targets", nargs="*", choices=[[], *TARGETS], default=[])
    chosen = parser.parse_args()
    names = chosen.targets or TARGETS
    return status(each for name in names for each in TARGETS[name](np.random.default_rng(18), chosen.runs))


if __name__ == "__main__":
    sys.exit(main())
