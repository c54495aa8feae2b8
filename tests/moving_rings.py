"""Rings in known motion and the records of shots of them, without anything of the package that is under test.

A shot is a set of numbers: for each laser two ordinates of its stripe's line and the abscissae of its two break points,
each at the time of its own frame, predicted with the equations of lines and circles in the ring's plane. The
measurement of a record comes from a Gauss-Newton fit of all twelve parameters with derivatives by differences.
"""

from dataclasses import dataclass, field, replace

import cv2
import numpy as np
from ring_scenes import RIGS, Ring, moved_rig, ring_at

from ringpose.geometry.rotations import tilt_basis
from ringpose.types.assumptions import Assumptions, MotionPrior, RigStability
from ringpose.types.pose import (
    LinearizationPoint,
    PoseLine,
    Priors,
    RadiusPrior,
    RingMeasurement,
)
from ringpose.types.rig import LaserPlanes

START_S = 1_700_000_000.0
FRAMES = (1, 2, 3)
"""Number of each laser's frame in the sequence off, 1, 2, 3, off."""

RING_SD = (0.3, 0.3, 0.3, 0.5, 0.5, 0.3, 0.3)
"""Prior of the ring's parameters, for the fit alone; the record does not contain it."""


@dataclass(frozen=True, kw_only=True)
class Motion:
    """Rigid motion: the centre of mass, `lever_m` behind the ring, has a velocity; the normal turns about `rate`."""

    ring: Ring
    velocity_m_s: np.ndarray
    rate_rad_s: np.ndarray
    lever_m: float = 0.0

    def at(self, time_s: float) -> Ring:
        normal = cv2.Rodrigues(self.rate_rad_s * time_s)[0] @ self.ring.normal
        mass = self.ring.center_m - self.lever_m * self.ring.normal + self.velocity_m_s * time_s
        return Ring(center_m=mass + self.lever_m * normal, normal=normal, radius_m=self.ring.radius_m)

    def velocity_at(self, time_s: float) -> np.ndarray:
        """Of the ring's centre."""
        return self.velocity_m_s + self.lever_m * np.cross(self.rate_rad_s, self.at(time_s).normal)

    def rates_at(self, time_s: float) -> np.ndarray:
        """Across the normal."""
        normal = self.at(time_s).normal
        return self.rate_rad_s - (self.rate_rad_s @ normal) * normal


class Pieces:
    """A motion in pieces; `_piece` returns the piece of a time, and the time since that piece began."""

    def at(self, time_s: float) -> Ring:
        piece, rest_s = self._piece(time_s)
        return piece.at(rest_s)

    def velocity_at(self, time_s: float) -> np.ndarray:
        piece, rest_s = self._piece(time_s)
        return piece.velocity_at(rest_s)


class Pushed(Pieces):
    """A motion whose velocity and angular velocity change at once."""

    def __init__(self, motion: Motion, time_s: float, change_m_s, change_rad_s=(0.0, 0.0, 0.0)) -> None:
        self.before, self.time_s = motion, time_s
        self.after = replace(
            motion,
            ring=motion.at(time_s),
            velocity_m_s=motion.velocity_m_s + change_m_s,
            rate_rad_s=motion.rate_rad_s + change_rad_s,
        )

    def _piece(self, time_s: float) -> tuple[Motion, float]:
        return (self.before, time_s) if time_s < self.time_s else (self.after, time_s - self.time_s)


class Wandering(Pieces):
    """Motion with white acceleration of the centre and of the angular velocity across the normal."""

    STEP_S = 1 / 120

    def __init__(self, motion: Motion, noise: tuple[float, float], duration_s: float, rng) -> None:
        steps = int(duration_s / self.STEP_S) + 2
        kicks = rng.normal(size=(steps, 6)) * np.sqrt(np.repeat(noise, 3) * self.STEP_S)
        ring, velocity, rate = motion.ring, motion.velocity_m_s.copy(), motion.rates_at(0.0)
        self._pieces = []
        for kick in kicks:
            self._pieces.append(Motion(ring=ring, velocity_m_s=velocity, rate_rad_s=rate))
            ring = self._pieces[-1].at(self.STEP_S)
            velocity = velocity + kick[:3]
            rate = rate + kick[3:]
            rate = rate - (rate @ ring.normal) * ring.normal

    def _piece(self, time_s: float) -> tuple[Motion, float]:
        number = max(int(time_s / self.STEP_S), 0)
        return self._pieces[number], time_s - number * self.STEP_S


@dataclass(frozen=True, kw_only=True)
class Shots:
    """How shots are taken, and their errors."""

    rig: str = "B"
    frame_s: float = 1 / 30
    sigma_px: float = 0.3
    line_px: float = 0.02
    known_radius_sd_m: float = 0.0
    """Standard deviation of the radii that the records assume; 0: they assume none."""
    offsets: dict[str, float] = field(default_factory=dict)
    """True errors of the light planes: `left.tilt_1`, ..."""
    stability: RigStability = RigStability()
    """What the records state about them."""
    motion: MotionPrior = MotionPrior(speed_sd_m_s=0.025, rate_sd_rad_s=0.044)
    """Prior of the motion by which the linearisation point is found."""


def features(center, normal, radius, velocity, rate, lasers: LaserPlanes, times, near) -> np.ndarray:
    """Normalised image coordinates of many rings at once: per laser y at two fixed x, and x of both break points.

    center, normal, velocity, rate (n, 3), radius (n, 2); rates rotate the ring about its centre, to second order.
    """
    found = []
    for m, d, t, guess in zip(lasers.normal, lasers.distance_m, times, near, strict=True):
        turn = np.cross(rate, normal) * t
        axis = normal + turn + np.cross(rate, turn) * t / 2
        axis = axis / np.linalg.norm(axis, axis=1, keepdims=True)
        c = center + velocity * t
        # line of the two planes: point p, direction u
        u = np.cross(axis, m)
        u = u / np.linalg.norm(u, axis=1, keepdims=True)
        inside = np.cross(u, axis)
        p = c + ((d - c @ m) / (inside @ m))[:, None] * inside
        middle = ((guess - p) * u).sum(axis=1)
        ends = []
        for edge in range(2):
            half = np.sqrt(np.maximum(radius[:, edge] ** 2 - ((p - c) ** 2).sum(axis=1), 1e-12))
            along = np.where(np.abs(middle - half) < np.abs(middle + half), half, -half)
            point = p + along[:, None] * u
            ends.append(point[:, 0] / point[:, 2])
        # image line: q . (x, y, 1) = 0 with q = m - d n / (n . c)
        q = m - d * axis / (axis * c).sum(axis=1)[:, None]
        x = guess[0] / guess[2] + np.array([-0.02, 0.02])
        y = -(q[:, [0]] * x + q[:, [2]]) / q[:, [1]]
        found.append(np.concatenate([y, np.stack(ends, axis=1)], axis=1))
    return np.concatenate(found, axis=1)


def rings_of(point: LinearizationPoint, increments: np.ndarray):
    """Rings at increments (n, 12) of the records' parameters about a point: the definition of the manual."""
    basis, n0, c0 = tilt_basis(point.normal), point.normal, point.center_m
    normal = n0 + increments[:, :2] @ basis
    normal = normal / np.linalg.norm(normal, axis=1, keepdims=True)
    share = (normal @ basis.T) / (1 + normal @ n0)[:, None]
    carried = basis - share[:, :, None] * (normal + n0)[:, None]
    in_plane = basis @ c0 + increments[:, 3:5]
    center = (n0 @ c0 + increments[:, [2]]) * normal + (in_plane[:, None] @ carried)[:, 0]
    radius = np.array([point.radius_inner_m, point.radius_outer_m]) + increments[:, 5:7]
    velocity = point.velocity_m_s + increments[:, 7:10]
    rate = ((basis @ point.rate_rad_s + increments[:, 10:12])[:, None] @ carried)[:, 0]
    return center, normal, radius, velocity, rate


def seen(motion, start_s: float, shots: Shots, rng) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """The numbers of one shot and their standard deviations, the times of its frames, and places near its stripes."""
    rig = RIGS[shots.rig]
    frames_s = start_s + shots.frame_s * np.array(FRAMES)
    lasers = moved_rig(rig, shots.offsets, shots.offsets.values()).lasers
    near = motion.at(float(frames_s.mean())).break_points_m(lasers).mean(axis=1)
    rings = [motion.at(time_s) for time_s in frames_s]
    poses = (np.stack(parts) for parts in zip(*((r.center_m, r.normal, r.radius_m) for r in rings), strict=True))
    still = features(*poses, np.zeros((3, 3)), np.zeros((3, 3)), lasers, np.zeros(3), near)
    found = still.reshape(3, 3, 4)[range(3), range(3)].ravel()  # each laser sees the ring at its own time
    focal = rig.camera.camera_matrix[0, 0]
    sigma = np.tile(np.array([2 * shots.line_px, 2 * shots.line_px, shots.sigma_px, shots.sigma_px]) / focal, 3)
    return found + (0.0 if rng is None else sigma * rng.normal(size=12)), sigma, frames_s, near


def measured(motion, start_s: float, shots: Shots, rng) -> tuple[RingMeasurement, float]:
    """The measurement of one shot, and the time at which it holds, after the start."""
    rig = RIGS[shots.rig]
    z, sigma, frames_s, near = seen(motion, start_s, shots, rng)
    reference_s = float(frames_s.mean())
    times, truth = frames_s - reference_s, motion.at(reference_s)

    motion_sd = [shots.motion.speed_sd_m_s] * 3 + [shots.motion.rate_sd_rad_s] * 2
    prior_sd = np.array([*RING_SD, *motion_sd])
    spread = 0.0 if rng is None else 0.01 * rng.normal()
    at = LinearizationPoint(
        center_m=truth.center_m + spread * tilt_basis(truth.normal)[0],
        normal=truth.normal,
        radius_inner_m=float(truth.radius_m[0]) + spread,
        radius_outer_m=float(truth.radius_m[1]) + spread,
        velocity_m_s=np.zeros(3),
        rate_rad_s=np.zeros(3),
    )
    step = 1e-6 * np.concatenate([np.zeros((1, 12)), np.eye(12), -np.eye(12)])
    move = np.full(12, np.inf)
    for iteration in range(6):
        values = features(*rings_of(at, step), rig.lasers, times, near) / sigma
        jacobian = ((values[1:13] - values[13:]) / 2e-6).T
        residual = z / sigma - values[0]
        if iteration == 5 or np.abs(move).max() < 1e-9:
            break
        information = jacobian.T @ jacobian + np.diag(prior_sd**-2.0)
        so_far = np.concatenate([np.zeros(7), -at.velocity_m_s, -tilt_basis(at.normal) @ at.rate_rad_s])
        move = np.linalg.solve(information, jacobian.T @ residual + so_far / prior_sd**2)
        center, normal, radius, velocity, rate = (part[0] for part in rings_of(at, move[None]))
        at = LinearizationPoint(
            center_m=center,
            normal=normal,
            radius_inner_m=float(radius[0]),
            radius_outer_m=float(radius[1]),
            velocity_m_s=velocity,
            rate_rad_s=rate,
        )
    names, columns = rig_columns(rig, at, times, near, sigma, shots)
    root = np.linalg.qr(np.concatenate([jacobian, columns, residual[:, None]], axis=1), mode="r")
    measurement = RingMeasurement(
        linearized_at=at, nuisance_parameters=names, square_root=root, degrees_of_freedom=0, chi2=0.0
    )
    return measurement, reference_s


def rig_columns(rig, at, times, near, sigma, shots: Shots) -> tuple[tuple[str, ...], np.ndarray]:
    """Derivatives by the parameters of the light planes, by differences."""
    if not (shots.stability.plane_tilt_rad or shots.stability.plane_distance_m):
        return (), np.zeros((12, 0))
    names = tuple(f"{laser}.{what}" for laser in rig.lasers.names for what in ("tilt_1", "tilt_2", "distance"))
    ring = rings_of(at, np.zeros((1, 12)))

    def at_offset(name: str, value: float) -> np.ndarray:
        return features(*ring, moved_rig(rig, [name], [value]).lasers, times, near)[0] / sigma

    return names, np.stack([(at_offset(name, 1e-7) - at_offset(name, -1e-7)) / 2e-7 for name in names], axis=1)


def record(motion, start_s: float, shots: Shots, rng, name: str | None = None) -> PoseLine:
    """The pose record of one shot, with its measurement and priors."""
    measurement, reference_s = measured(motion, start_s, shots, rng)
    radius, sd_m = None, shots.known_radius_sd_m
    if sd_m:
        inner_m, outer_m = motion.at(0.0).radius_m.tolist()
        radius = RadiusPrior(inner_m=inner_m, outer_m=outer_m, inner_sd_m=sd_m, outer_sd_m=sd_m, source="given")
    return PoseLine(
        shot=name or f"{start_s:.4f}",
        stamp_s=START_S + start_s + shots.frame_s,
        pose_stamp_s=START_S + reference_s,
        pose=None,
        measurement=measurement,
        priors=Priors(assumptions=Assumptions(stability=shots.stability), radius=radius),
    )


def drawn_motion(rng, distance_m=0.5, speed_m_s=0.01, rate_deg_s=0.5, lever_m=0.0, rig="B", **ring) -> Motion:
    """Constant velocity, rates across the normal; standard deviations per axis."""
    first = ring_at(RIGS[rig], distance_m=distance_m, tilt_rad=tuple(0.1 * rng.normal(size=2)), **ring)
    rate = np.deg2rad(rate_deg_s) * rng.normal(size=3)
    rate -= (rate @ first.normal) * first.normal
    return Motion(ring=first, velocity_m_s=speed_m_s * rng.normal(size=3), rate_rad_s=rate, lever_m=lever_m)


def stream(motion, duration_s: float, shots: Shots, rng, rate_hz: float = 6.0) -> list[PoseLine]:
    """Records of shots at a fixed rate."""
    return [record(motion, number / rate_hz, shots, rng) for number in range(int(duration_s * rate_hz))]


def grasp_distance_m(grasp_m: np.ndarray, ring: Ring) -> float:
    """Distance of a grasp point from the middle of the ring's band."""
    away = grasp_m - ring.center_m
    axial = float(away @ ring.normal)
    radial = float(np.linalg.norm(away - axial * ring.normal)) - float(ring.radius_m.mean())
    return float(np.hypot(axial, radial))
