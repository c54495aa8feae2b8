"""Consistency of reported covariances where everything that they contain is drawn: `make bench-targets`.

Features are drawn from the ring's model (as by `ringpose simulate --features`) for both rigs of the paper, at 0.3, 0.5
and 1 m, in the dark and in the sun. Each run draws a rig from its covariance and stability, a ring from its tolerance,
and an outer radius, which is unknown, or known with its standard deviation. Of the mean NEES of all quantities without
a weak flag at most two may lie outside their 99 % bands, and none outside 99.99 %.
"""

import sys
from collections.abc import Iterator
from dataclasses import replace
from itertools import product

import numpy as np
from benchmarks.limits import Figure, band, options, printed, target

from ringpose.estimate.pose_errors import circle_error, mahalanobis_squared, tilt_error_rad
from ringpose.files.scenes.scene import read_scene
from ringpose.files.studies.specification import PRESETS
from ringpose.measure.stream import pose_line
from ringpose.pose.advice import RADIUS_SD_M
from ringpose.simulate.features import Deviations, drawn_features
from ringpose.types.assumptions import RING_TOLERANCE_M, AssumptionOptions
from ringpose.types.pose import KnownRadii, PoseFlag, PoseLine
from ringpose.types.rig import ParameterCovariance, Rig
from ringpose.types.scene import Approach, Scene
from ringpose.types.session import parsed_sequence
from ringpose.types.truth import Truth

RIGS = {"A": "paper-virtual-scene.yaml", "B": "paper-physical-scene.yaml"}
DISTANCES_M = (0.3, 0.5, 1.0)
LIGHTS = {"dark": "dim", "sun": "strong"}
RADII_M = (0.45, 0.75)
OPTIONS = AssumptionOptions(still=True)

CAMERA_SD = {"fx": 0.3, "fy": 0.3, "cx": 0.3, "cy": 0.3}
"""Pixels."""

PLANE_SD = {"tilt_1": 1e-4, "tilt_2": 1e-4, "distance": 2e-5}
"""Radians, metres."""

FEWEST = 20
"""Values of which a mean is judged."""

DEGREES_OF_FREEDOM = {"centre": 3, "normal": 2, "grasp, normal": 1, "grasp, radial": 1, "radius": 1}


def calibrated(rig: Rig) -> Rig:
    """The rig with the covariance of a good calibration."""
    sd = CAMERA_SD | {f"{name}.{each}": PLANE_SD[each] for name in rig.lasers.names for each in PLANE_SD}
    covariance = ParameterCovariance(parameters=tuple(sd), data=np.diag(np.square(list(sd.values()))))
    return replace(rig, covariance=covariance)


def scene_of(kind: str, distance_m: float, light: str, seed: int) -> tuple[Scene, KnownRadii]:
    """The scene of one run, and what is said of its ring's radius."""
    rng = np.random.default_rng([7, seed])
    scene = read_scene(PRESETS / RIGS[kind])
    larger_m = rng.uniform(*RADII_M) - scene.ring.radius_outer_m
    ring = replace(scene.ring, profile_m=scene.ring.profile_m + np.array([larger_m, 0.0]))
    view = Approach(count=1, distances_m=(distance_m,), lights=(LIGHTS[light],), seed=seed, name="r", tilt_rad=0.15)
    scene = replace(
        scene,
        rig=calibrated(scene.rig),
        ring=ring,
        sequence=tuple(step.mask(3) for step in parsed_sequence("off,1,2,3,off")),
        seed=seed,
        views=(),
        approaches=(view,),
    )
    sd_m = np.full(2, RADIUS_SD_M)
    said_m = np.array([ring.radius_inner_m, ring.radius_outer_m]) + sd_m * rng.standard_normal(2)
    return scene, KnownRadii(radius_m=said_m, sd_m=sd_m)


def nees_by_quantity(line: PoseLine, truth: Truth) -> Iterator[tuple[str, float]]:
    """The NEES of each quantity of a line that has no weak flag."""
    pose = line.pose
    if PoseFlag.NORMAL_WEAK not in line.flags:
        yield "normal", mahalanobis_squared(tilt_error_rad(pose.normal, truth.normal), pose.covariance[:2, :2]) / 2
    if PoseFlag.CENTER_WEAK not in line.flags and np.isfinite(pose.center_m).all():
        yield "centre", mahalanobis_squared(pose.center_m - truth.center_m, pose.covariance_center_m2) / 3
    if PoseFlag.RADIUS_WEAK not in line.flags and np.isfinite(pose.radius_outer_m):
        yield "radius", (pose.radius_outer_m - truth.radius_outer_m) ** 2 / pose.covariance[6, 6]
    if PoseFlag.GRASP_WEAK not in line.flags:
        middle_m = (truth.radius_inner_m + truth.radius_outer_m) / 2
        axes, error_m = circle_error(pose.grasp_m, truth.center_m, truth.normal, middle_m)
        variance = np.diag(axes @ pose.covariance_grasp_m2 @ axes.T)
        yield from zip(("grasp, normal", "grasp, radial"), error_m**2 / variance, strict=True)


def cell(kind: str, distance_m: float, light: str, runs: int) -> dict[tuple[str, str], list[float]]:
    """NEES by what is said of the radius, and by quantity."""
    found: dict[tuple[str, str], list[float]] = {}
    deviations = Deviations(rig_errors=True, ring_tolerance_m=RING_TOLERANCE_M)
    for seed in range(runs):
        scene, known = scene_of(kind, distance_m, light, seed)
        (shot,) = drawn_features(scene, deviations)
        for name, radii in ("radius unknown", None), ("radius known", known):
            line = pose_line(shot.detection, scene.rig, known=radii, options=OPTIONS)
            if line.pose is not None:
                for quantity, value in nees_by_quantity(line, shot.truth):
                    found.setdefault((name, quantity), []).append(value)
    return found


def figures(runs: int) -> Iterator[Figure]:
    outside, far_outside = 0, 0
    for kind, distance_m, light in product(RIGS, DISTANCES_M, LIGHTS):
        for (said, quantity), values in sorted(cell(kind, distance_m, light, runs).items()):
            if len(values) < FEWEST:
                continue
            dof, mean = DEGREES_OF_FREEDOM[quantity], float(np.mean(values))
            (least, most), (low, high) = (band(len(values), dof, share) for share in (0.99, 0.9999))
            outside += not least <= mean <= most
            far_outside += not low <= mean <= high
            name = f"NEES of {quantity}, {kind}, {distance_m} m, {light}, {said}, {len(values)} runs"
            yield target(name, mean, most, least)
    yield target("mean NEES outside their 99 % bands", outside, 2)
    yield target("mean NEES outside their 99.99 % bands", far_outside, 0)


def main() -> int:
    *_, outside, far_outside = printed(figures(options(__doc__, runs=100).parse_args().runs))
    return 0 if outside.is_kept and far_outside.is_kept else 3


if __name__ == "__main__":
    sys.exit(main())
