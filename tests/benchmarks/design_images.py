"""Errors of simulated shots beside the maps of `ringpose bench design`.

At random places that a map does not hatch, shots are rendered and measured; the root mean square errors of centre and
normal are divided by the map's, with the 99 % band of this ratio. `--image-scale` reduces the image to save time.
Status 3 if a ratio of the centre is outside its band, or a shot has no pose.
"""

import argparse
import sys
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy.stats import chi2

from ringpose.bench.design.maps import Place, place_result, scene_at
from ringpose.files.scenes.scene import read_scene
from ringpose.geometry.rotations import angle_between
from ringpose.pose.pipeline import pose_line
from ringpose.simulate.features import Deviations, drawn_features
from ringpose.simulate.pipeline import simulated_shot
from ringpose.types.arrays import Array, Float64
from ringpose.types.assumptions import NOISE_ONLY, AssumptionOptions
from ringpose.types.scene import Scene

EXAMPLE = Path(__file__).parents[2] / "examples" / "scene.yaml"


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PlaceErrors:
    """Errors of the shots at one place beside the map's."""

    rms: Float64[Array, "quantity=2"]
    """Root mean squares of the centre's (m) and the normal's (rad)."""
    expected: Float64[Array, "quantity=2"]
    """The map's."""
    band: tuple[float, float]
    """99 % of the ratios of the centre's lie in it if the map is right, along one direction, the widest band."""
    poses: int
    """Shots with a finite pose; the others are in no statistic."""
    flagged: int
    """Poses whose status is not `ok`."""

    @property
    def ratio(self) -> Float64[Array, "quantity=2"]:
        """Errors over the map's."""
        return self.rms / self.expected

    @property
    def inside(self) -> bool:
        """Whether the centre's ratio is in its band."""
        return bool(self.band[0] < self.ratio[0] < self.band[1])


def place_errors(scene: Scene, place: Place, shots: int, deviations: Deviations | None = None) -> PlaceErrors:
    """Errors of shots that are drawn with these deviations, or without any rendered and measured with noise only.

    If none has a pose, they are infinite and the band is empty.
    """
    at_place, found, flagged = scene_at(scene, place), [], 0
    for seed in range(shots):
        seeded = replace(at_place, seed=seed)
        if deviations is None:
            source, truth = simulated_shot(seeded, seeded.views, 0)
            line = pose_line(source, scene.rig, options=NOISE_ONLY)
        else:
            drawn = next(drawn_features(seeded, deviations, 1))
            truth, options = drawn.truth, AssumptionOptions() if deviations.rig_errors else NOISE_ONLY
            line = pose_line(drawn.detection, scene.rig, options=options)
        if line.pose is not None and np.isfinite(line.pose.center_m).all():
            angle_rad = angle_between(line.pose.normal[None], truth.normal[None])[0]
            found.append((np.linalg.norm(line.pose.center_m - truth.center_m), angle_rad))
            flagged += line.status != "ok"
    sd = place_result(scene, place).sd
    low, high = np.sqrt(chi2.ppf([0.005, 0.995], len(found)) / len(found)) if found else (0.0, 0.0)
    return PlaceErrors(
        rms=np.sqrt(np.mean(np.square(found), axis=0)) if found else np.full(2, np.inf),
        expected=np.array([sd["center_m"], sd["normal_rad"]]),
        band=(float(low), float(high)),
        poses=len(found),
        flagged=flagged,
    )


def random_places(scene: Scene, rng: np.random.Generator, count: int) -> list[Place]:
    """Places that a map does not hatch."""
    found: list[Place] = []
    while len(found) < count:
        place = Place(
            distance_m=float(rng.uniform(0.3, 1.0)),
            offset_x=float(rng.uniform(-0.2, 0.2)),
            pitch_rad=float(rng.uniform(-0.15, 0.15)),
            yaw_rad=float(rng.uniform(-0.15, 0.15)),
        )
        if not place_result(scene, place).above_bound:
            found.append(place)
    return found


def reduced(scene: Scene, scale: float) -> Scene:
    """The scene in an image of fewer and larger pixels."""
    camera = scene.rig.camera
    matrix = camera.camera_matrix * np.array([[scale], [scale], [1.0]])
    matrix[:2, 2] += (scale - 1) / 2  # pixel (0, 0) is the centre of the top-left pixel
    size = {name: round(scale * getattr(camera, name)) for name in ("image_width", "image_height")}
    smaller = replace(camera, camera_matrix=matrix, **size)
    sensor = replace(scene.sensor, pixel_m=scene.sensor.pixel_m / scale)
    return replace(scene, rig=replace(scene.rig, camera=smaller), sensor=sensor)


def main() -> int:
    """Print a line for each place."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--places", type=int, default=5)
    parser.add_argument("--shots", type=int, default=50)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--image-scale", type=float, default=1.0)
    parser.add_argument("--features", action="store_true", help="draw features instead of rendering images")
    given = parser.parse_args()
    scene, outside = reduced(read_scene(EXAMPLE), given.image_scale), 0
    heading = "distance  offset  pitch    yaw    centre mm    map  ratio  normal deg    map  ratio    band"
    print(heading + "        poses  flagged")
    for place in random_places(scene, np.random.default_rng(given.seed), given.places):
        found = place_errors(scene, place, given.shots, Deviations() if given.features else None)
        outside += not found.inside or found.poses < given.shots
        print(
            f"{place.distance_m:8.3f} {place.offset_x:7.3f} {place.pitch_rad:6.3f} {place.yaw_rad:6.3f}"
            f"   {1e3 * found.rms[0]:10.3f} {1e3 * found.expected[0]:6.3f} {found.ratio[0]:6.2f}"
            f"  {np.degrees(found.rms[1]):10.4f} {np.degrees(found.expected[1]):6.4f} {found.ratio[1]:6.2f}"
            f"   {found.band[0]:.2f}..{found.band[1]:.2f} {found.poses:8d} {found.flagged:8d}",
            flush=True,
        )
    return 3 if outside else 0


if __name__ == "__main__":
    sys.exit(main())
