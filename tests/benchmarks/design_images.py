"""Errors in rendered images beside the maps of `ringpose bench design`.

At places where the estimator does not flag the pose, shots are rendered and measured with noise only; the root mean
square errors of centre and normal are divided by the map's, with the 99 % band of this ratio. `--image-scale` reduces
the image to save time. Status 3 if a ratio is outside its band.
"""

import argparse
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.stats import chi2

from ringpose.bench.design.maps import Place, place_result, scene_at
from ringpose.files.scenes.scene import read_scene
from ringpose.geometry.rotations import angle_between
from ringpose.pose.pipeline import pose_line
from ringpose.simulate.features import drawn_features
from ringpose.simulate.pipeline import simulated_shot
from ringpose.types.assumptions import NOISE_ONLY
from ringpose.types.pose import RingPose
from ringpose.types.scene import Scene, Truth

EXAMPLE = Path(__file__).parents[2] / "examples" / "scene.yaml"


def reduced(scene: Scene, scale: float) -> Scene:
    """The scene in an image of fewer and larger pixels."""
    camera = scene.rig.camera
    matrix = camera.camera_matrix * np.array([[scale], [scale], [1.0]])
    matrix[:2, 2] += (scale - 1) / 2  # pixel (0, 0) is the centre of the top-left pixel
    size = {name: round(scale * getattr(camera, name)) for name in ("image_width", "image_height")}
    smaller = replace(camera, camera_matrix=matrix, **size)
    sensor = replace(scene.sensor, pixel_m=scene.sensor.pixel_m / scale)
    return replace(scene, rig=replace(scene.rig, camera=smaller), sensor=sensor)


def random_places(scene: Scene, rng: np.random.Generator, count: int) -> list[Place]:
    """Places at which the estimator does not flag the pose as weak."""
    found: list[Place] = []
    while len(found) < count:
        place = Place(
            distance_m=float(rng.uniform(0.3, 1.0)),
            offset_x=float(rng.uniform(-0.2, 0.2)),
            pitch_rad=float(rng.uniform(-0.15, 0.15)),
            yaw_rad=float(rng.uniform(-0.15, 0.15)),
        )
        if not place_result(scene, place).weak:
            found.append(place)
    return found


def errors(scene: Scene, place: Place, shots: int, images: bool) -> tuple[np.ndarray, int]:
    """Errors of centre (m) and normal (rad), a row a shot with both; and the number of flagged ones among them."""
    at_place, found, flagged = scene_at(scene, place), [], 0
    for seed in range(shots):
        seeded = replace(at_place, seed=seed)
        if images:
            source, truth = simulated_shot(seeded, seeded.views, 0)
        else:
            drawn = next(drawn_features(seeded))
            source, truth = drawn.detection, drawn.truth
        line = pose_line(source, scene.rig, options=NOISE_ONLY)
        if line.pose is not None and np.isfinite(line.pose.center_m).all():
            found.append(_error(line.pose, truth))
            flagged += line.status != "ok"
    return np.array(found).reshape(-1, 2), flagged


def _error(pose: RingPose, truth: Truth) -> tuple[float, float]:
    assert truth.center_m is not None
    assert truth.normal is not None
    angle_rad = angle_between(pose.normal[None], truth.normal[None])[0]
    return float(np.linalg.norm(pose.center_m - truth.center_m)), float(angle_rad)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--places", type=int, default=5)
    parser.add_argument("--shots", type=int, default=50)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--image-scale", type=float, default=1.0)
    parser.add_argument("--features", action="store_true", help="draw features instead of rendering images")
    given = parser.parse_args()
    scene = reduced(read_scene(EXAMPLE), given.image_scale)
    outside = 0
    heading = "distance  offset  pitch    yaw    centre mm    map  ratio  normal deg    map  ratio    band"
    print(heading + "        poses  flagged")
    for place in random_places(scene, np.random.default_rng(given.seed), given.places):
        found, flagged = errors(scene, place, given.shots, not given.features)
        expected = place_result(scene, place).sd
        rms = np.sqrt(np.mean(np.square(found), axis=0))
        ratio = rms / [expected["center_m"], expected["normal_rad"]]
        # squares along one direction have the widest band
        low, high = np.sqrt(chi2.ppf([0.005, 0.995], len(found)) / len(found))
        outside += not low < ratio[0] < high
        print(
            f"{place.distance_m:8.3f} {place.offset_x:7.3f} {place.pitch_rad:6.3f} {place.yaw_rad:6.3f}"
            f"   {1e3 * rms[0]:10.3f} {1e3 * expected['center_m']:6.3f} {ratio[0]:6.2f}"
            f"  {np.degrees(rms[1]):10.4f} {np.degrees(expected['normal_rad']):6.4f} {ratio[1]:6.2f}"
            f"   {low:.2f}..{high:.2f} {len(found):8d} {flagged:8d}",
            flush=True,
        )
    return 3 if outside else 0


if __name__ == "__main__":
    sys.exit(main())
