"""Tracks of a true ring among random ones, and the parameters of the search for its faces."""

from typing import NamedTuple

import numpy as np
from drawn_scene import DrawnScene, drawn_rig, true_break_points

from ringpose.geometry.rays import undistorted_pixels
from ringpose.kernels.lines import CandidateParams, RingParams, UnionParams


class Rules(NamedTuple):
    """Parameters of `ring_faces`."""

    ring: RingParams
    unions: UnionParams = UnionParams()
    candidates: CandidateParams = CandidateParams()


RULES = Rules(RingParams(focal_x=1781.0, focal_y=1780.0, principal_x=803.0, principal_y=596.0, image_height=1200.0))
ANY = 0b111


def with_rules(**changed):
    """The rules with some changed."""
    parts = [part._replace(**{k: v for k, v in changed.items() if k in part._fields}) for part in RULES]
    return Rules(*parts)


def rules_of(rig):
    matrix = rig.camera.camera_matrix
    focal, principal = matrix[[0, 1], [0, 1]].tolist(), matrix[:2, 2].tolist()
    return dict(zip(("focal_x", "focal_y", "principal_x", "principal_y"), [*focal, *principal], strict=True))


def planes():
    lasers = drawn_rig().lasers
    return lasers.normal / lasers.distance_m[:, None]


def tracks_between(start_px, end_px, *, count=40.0, scatter=0.1, spilt=0.0, laser=-1.0, clipped=0.0):
    """Tracks from there to there, undistorted pixels; the rest is the same for all, or given for each."""
    middle = (start_px + end_px) / 2
    slope = (end_px[:, 1] - start_px[:, 1]) / (end_px[:, 0] - start_px[:, 0])
    columns = (laser, count, start_px[:, 0], end_px[:, 0], *middle.T, slope, scatter, 2.0, clipped, spilt)
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
