"""The filter against one adjustment of all shots together, which knows nothing of filters."""

import numpy as np
import pytest
from moving_rings import START_S, Shots, drawn_motion, features, record, rings_of, seen
from ring_scenes import RIGS

from ringpose.geometry.rotations import tilt_basis
from ringpose.track.pipeline import Tracker
from ringpose.types.pose import LinearizationPoint

STEP = 1e-6 * np.concatenate([np.zeros((1, 12)), np.eye(12), -np.eye(12)])


def adjusted(shots_seen, reference_s: float, start: LinearizationPoint) -> tuple[LinearizationPoint, np.ndarray]:
    """The most likely ring and constant motion at a time, and the covariance of the twelve parameters."""
    at = start
    for _ in range(8):
        rows, residuals = [], []
        for z, sigma, frames_s, near in shots_seen:
            values = features(*rings_of(at, STEP), RIGS["B"].lasers, frames_s - reference_s, near) / sigma
            rows.append(((values[1:13] - values[13:]) / 2e-6).T)
            residuals.append(z / sigma - values[0])
        jacobian, residual = np.concatenate(rows), np.concatenate(residuals)
        step = np.linalg.lstsq(jacobian, residual, rcond=None)[0]
        center, normal, radius, velocity, rate = (part[0] for part in rings_of(at, step[None]))
        at = LinearizationPoint(
            center_m=center,
            normal=normal,
            radius_inner_m=float(radius[0]),
            radius_outer_m=float(radius[1]),
            velocity_m_s=velocity,
            rate_rad_s=rate,
        )
    return at, np.linalg.inv(jacobian.T @ jacobian)


@pytest.mark.slow
def test_a_track_is_the_adjustment_of_all_its_shots_if_the_target_moves_steadily(rng):
    apart = []
    for run in range(6):
        motion, tracker, all_seen = drawn_motion(rng), Tracker(None), []
        for number in range(18):
            noise = [run, number]
            all_seen.append(seen(motion, number / 6, Shots(), np.random.default_rng(noise)))
            tracker.add(record(motion, number / 6, Shots(), np.random.default_rng(noise)))
        line = tracker.line_at(0.0)
        truth = motion.at(line.stamp_s - START_S)
        start = LinearizationPoint(
            center_m=truth.center_m,
            normal=truth.normal,
            radius_inner_m=0.567,
            radius_outer_m=0.597,
            velocity_m_s=motion.velocity_m_s,
            rate_rad_s=motion.rates_at(line.stamp_s - START_S),
        )
        batch, covariance = adjusted(all_seen, line.stamp_s - START_S, start)
        sd_m = np.sqrt(np.diag(line.pose.covariance_center_m2))
        apart.append((line.pose.center_m - batch.center_m) / sd_m)
        tilts = tilt_basis(batch.normal) @ (line.pose.normal - batch.normal)
        apart.append(tilts / np.sqrt(np.diag(line.pose.covariance)[:2]))
        ratio = np.sqrt(np.diag(line.pose.covariance)[[0, 1, 5, 6]] / np.diag(covariance)[[0, 1, 5, 6]])
        assert (ratio > 0.9).all()  # no information that the shots do not contain
        assert (ratio < 1.35).all()  # process noise of the models adds some

    assert np.sqrt(np.mean(np.concatenate(apart) ** 2)) < 0.35
