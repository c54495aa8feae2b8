"""Detection of moved light planes in streams of shots against its targets: `make bench-targets`.

Streams of 50 shots at different poses, drawn at pose level (rig B, break points 0.3 px, lines 0.02 px, radius unknown).
The planes of the real rig differ from the calibrated ones as `stability` states; in some rows one or all of them have
moved besides. `still` shots have one ring each; the rings of `tumbling` ones turn at 1 to 8 degrees a second with their
centre of mass 1 m behind them, drift at up to 0.1 m/s, and are seen by each laser at another time.
"""

import sys
from collections.abc import Callable, Iterator
from dataclasses import replace
from itertools import product

import numpy as np
from benchmarks.limits import WRONG_SIGMAS, Figure, options, status, target
from moving_rings import Motion
from ring_scenes import RIGS, Scene, edges_in_frames, face_points_of, make_scene, scene_of, visible_edges_of
from ring_streams import ASSUMED, measured_stream, moved, poses_before, within_stability
from scipy.stats import chi2, ncx2, norm, poisson

from ringpose.estimate.pose_errors import circle_error, mahalanobis_squared, tilt_error_rad
from ringpose.estimate.solver import ALARM_SIGMAS
from ringpose.geometry.rotations import tilt_basis
from ringpose.pose.rig_monitor import RigEvidence
from ringpose.types.assumptions import motion_prior
from ringpose.types.detection import BreakPoints, RingEdgePoints
from ringpose.types.pose import PoseFlag, PoseLine

SHOTS = 50
FRAME_S = 1 / 30
EDGE_POINTS = 40
REDUNDANCY = 5
"""Degrees of freedom of three stripes with both ends."""

OBVIOUS = 60.0
"""Noncentrality above which nothing may be `ok` and wrong."""

RING_PARAMETERS = 7
PLANES = {"tilt": (np.radians(0.1), 0.0), "shift": (0.0, 0.3e-3), "all": (np.radians(0.5), 0.0)}
"""Tilt [rad] and shift [m] of one plane; `all`: of each plane, in a direction of its own."""

ASSUMED_OF = {"still": ASSUMED, "tumbling": replace(ASSUMED, motion=motion_prior(0.2, 8.0))}


Measured = tuple[Scene, BreakPoints] | tuple[Scene, BreakPoints, RingEdgePoints]


def tumbling(rig, rng, shots: int) -> Iterator[Measured]:
    """Break points of lasers that see the ring one after the other, and its edges in the off frames around them."""
    for _ in range(shots):
        tilt, distance_m = tuple(rng.uniform(-0.2, 0.2, 2)), float(rng.uniform(0.3, 0.7))
        scene = make_scene(rig, distance_m=distance_m, tilt_rad=tilt)
        axis, drift = rng.normal(size=2) @ tilt_basis(scene.ring.normal), rng.normal(size=3)
        motion = Motion(
            ring=scene.ring,
            velocity_m_s=rng.uniform(0.0, 0.1) * drift / np.linalg.norm(drift),
            rate_rad_s=np.radians(rng.uniform(1.0, 8.0)) * axis / np.linalg.norm(axis),
            lever_m=1.0,
        )
        stamp_s, off_s = FRAME_S * np.arange(-1, 2), FRAME_S * np.array([-2, 2])
        by_frame = [scene_of(rig, motion.at(s)) for s in stamp_s]
        of_each = {
            name: np.array([getattr(each, name)[laser] for laser, each in enumerate(by_frame)])
            for name in ("points_m", "position_px")
        }
        points = replace(face_points_of(replace(scene, **of_each), 0.3, 0.02, rng), stamp_s=100.0 + stamp_s)
        rings = {100.0 + s: motion.at(s) for s in off_s}
        yield scene, points, edges_in_frames(rig, rings, EDGE_POINTS, 0.3, rng)


STREAMS: dict[str, Callable[..., Iterator[Measured]]] = {"still": poses_before, "tumbling": tumbling}


def single_shots(rng, shots: int) -> tuple[int, float, int]:
    """Single shots with edges after one plane has moved by 0.1 to 1 degree or 0.2 to 2 mm, before a stream shows it.

    The number that is `ok` and wrong; the mean number that an ideal chi-squared test with the same stability would
    leave, by the information of a shot without noise at the same place; and how many of the first have a noncentrality
    above 60.
    """
    rig, threshold = RIGS["B"], chi2.ppf(norm.cdf(ALARM_SIGMAS), REDUNDANCY)
    wrong, left, obvious = 0, 0.0, 0
    for number in range(shots):
        laser, direction = int(rng.integers(3)), rng.uniform(0.0, 2 * np.pi)
        if number % 2:
            tilts, shift_m = np.radians(rng.uniform(0.1, 1.0)) * np.array([np.cos(direction), np.sin(direction)]), 0.0
        else:
            tilts, shift_m = np.zeros(2), rng.choice([-1, 1]) * rng.uniform(0.2e-3, 2e-3)
        real = moved(within_stability(rig, rng), laser, tilts, shift_m)
        ((seen, points),) = poses_before(real, rng, 1)
        scene = scene_of(rig, seen.ring)
        edges, exact = visible_edges_of(scene, EDGE_POINTS, 0.3, rng), visible_edges_of(scene, EDGE_POINTS, 0.3)
        (line,), _ = measured_stream(rig, [(seen, points, edges)])
        (expected,), _ = measured_stream(rig, [(scene, face_points_of(scene, 0.3, 0.02), exact)])
        change = np.array([*tilts, shift_m])
        noncentrality, offsets = shown_by(expected, rig, laser, change)
        unflagged_wrong = line.status == "ok" and is_wrong(line, seen.ring)
        wrong += unflagged_wrong
        obvious += unflagged_wrong and noncentrality > OBVIOUS
        left += ncx2.cdf(threshold, REDUNDANCY, noncentrality) * share_beyond(offsets)
    return wrong, left, obvious


def shown_by(line, rig, laser: int, change: np.ndarray) -> tuple[float, list[float]]:
    """Noncentrality of a shot's chi-squared if a plane has changed, and by how many sigmas normal and centre err."""
    evidence, rows = RigEvidence(rig, rig.stability), line.measurement.square_root
    names = line.measurement.nuisance_parameters
    of_rig = [number for number, name in enumerate(names) if name in evidence.parameters]
    at = [evidence.parameters.index(names[number]) for number in of_rig]
    changed = [at.index(each) for each in evidence.columns(laser)]
    jacobian, by_rig = rows[:, :RING_PARAMETERS], rows[:, -1 - len(names) : -1][:, of_rig]
    weight = np.linalg.inv(np.eye(len(rows)) + by_rig @ evidence.prior[np.ix_(at, at)] @ by_rig.T)
    effect = by_rig[:, changed] @ change
    covariance = np.linalg.inv(jacobian.T @ weight @ jacobian)
    error = covariance @ jacobian.T @ weight @ effect
    left = effect - jacobian @ error
    squares = [error[part] @ np.linalg.solve(covariance[part, part], error[part]) for part in (slice(2), slice(2, 5))]
    return float(left @ weight @ left), np.sqrt(squares).tolist()


def share_beyond(offsets: list[float]) -> float:
    """Probability that the normal or the centre errs by more than 5 sigma if they err by these in the mean."""
    inside = [ncx2.cdf(WRONG_SIGMAS**2, dof, offset**2) for offset, dof in zip(offsets, (2, 3), strict=True)]
    return float(1.0 - np.prod(inside))


def is_wrong(line: PoseLine, ring) -> bool:
    """Whether a quantity without a weak flag errs by more than 5 sigma."""
    pose, squares = line.pose, [0.0]
    if PoseFlag.NORMAL_WEAK not in line.flags:
        squares.append(mahalanobis_squared(tilt_error_rad(pose.normal, ring.normal), pose.covariance[:2, :2]))
    if PoseFlag.CENTER_WEAK not in line.flags:
        squares.append(mahalanobis_squared(pose.center_m - ring.center_m, pose.covariance_center_m2))
    if PoseFlag.GRASP_WEAK not in line.flags:
        axes, error = circle_error(pose.grasp_m, ring.center_m, ring.normal, ring.radius_m.mean())
        squares.append(mahalanobis_squared(error, axes @ pose.covariance_grasp_m2 @ axes.T))
    return max(squares) > WRONG_SIGMAS**2


def warned(kind: str, changed: str, rng) -> bool:
    """Whether a stream leads to a warning: about the plane that has moved, about any where all or none have."""
    rig = RIGS["B"]
    real, laser, name = within_stability(rig, rng), int(rng.integers(3)), None
    for each in range(3) if changed == "all" else [laser] if changed in PLANES else []:
        tilt_rad, shift_m = PLANES[changed]
        direction = rng.uniform(0.0, 2 * np.pi)
        real = moved(real, each, tilt_rad * np.array([np.cos(direction), np.sin(direction)]), shift_m)
    if changed in ("tilt", "shift"):
        name = f"laser {rig.lasers.names[laser]} "
    scenes = list(STREAMS[kind](real, rng, SHOTS))
    _, warnings = measured_stream(rig, scenes, until=name or "", assumed=ASSUMED_OF[kind])
    return any((name or "") in text for text in warnings.values())


def figures(streams: int) -> Iterator[Figure]:
    wrong, left, obvious = single_shots(np.random.default_rng(11), 10 * streams)
    yield target(f"ok and wrong of {10 * streams} single shots, planes moved", wrong, poisson.ppf(0.99, left))
    yield target("of them with a noncentrality above 60", obvious, 0)
    for kind, changed in product(STREAMS, ["none", *PLANES]):
        share = np.mean([warned(kind, changed, np.random.default_rng([17, stream])) for stream in range(streams)])
        name = f"share of {streams} {kind} streams with a warning, planes moved: {changed}"
        yield target(name, share, 1 / 1000) if changed == "none" else target(name, share, 1.0, 0.9)


if __name__ == "__main__":
    sys.exit(status(figures(options(__doc__, streams=60).parse_args().streams)))
