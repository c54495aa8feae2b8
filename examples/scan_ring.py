#!/usr/bin/env python3
"""A robot scans a ring: shots from all around it become one point cloud in the robot's base, shown by ringpose view.

    python3 scan_ring.py FOLDER

The virtual camera of scene.yaml stands half a metre before the ring's band; the robot carries it around the ring's axis
and says where it stands. FOLDER then has shots, robot poses, rig, the cloud as cloud.ply, and scan.html.
"""

import argparse
import json
import math
import subprocess
import sys
from pathlib import Path

import numpy as np
import yaml
from scipy.spatial.transform import Rotation
from simulated_robot import REPEATABILITY_M, REPEATABILITY_RAD, STANDS_S, TOOL_FROM_CAMERA, tool_poses

import ringpose

HERE = Path(__file__).parent


def write_scene(folder, views):
    """The scene with views that turn around the ring's axis, and its rig."""
    scene = yaml.safe_load((HERE / "scene.yaml").read_text())
    del scene["boards"]
    scene["period_s"] = 5.0  # in which the robot goes to the next place and stands
    scene["trajectory"] = [
        {
            "name": f"scan_{number:02d}",
            "center_m": [0.57, 0.02, 0.5],
            "normal": [0.0, 0.1, -math.sqrt(0.99)],
            "roll_rad": 2 * math.pi * number / views,
            "light": "normal",
        }
        for number in range(views)
    ]
    (folder / "scene.yaml").write_text(yaml.safe_dump(scene))
    (folder / "scene-rig.yaml").write_bytes((HERE / "scene-rig.yaml").read_bytes())
    return folder / "scene.yaml"


def write_rig(folder):
    """The rig with the camera's mount on the tool and the robot's repeatability, as calibrate-mount writes them."""
    rig = yaml.safe_load((folder / "simulated" / "rig.yaml").read_text())
    rig["mount"] = {
        "tool_from_camera": TOOL_FROM_CAMERA.tolist(),
        "robot_rotation_sd_rad": REPEATABILITY_RAD,
        "robot_translation_sd_m": REPEATABILITY_M,
    }
    (folder / "rig.yaml").write_text(yaml.safe_dump(rig))
    return folder / "rig.yaml"


def write_robot_poses(folder, scene):
    """Where the robot says that it stands while each shot is taken."""
    poses = tool_poses(ringpose.read_scene(scene))
    with (folder / "robot.jsonl").open("w") as lines:
        for path in sorted((folder / "simulated" / "shots").glob("*.npz")):
            shot = ringpose.read_shot(path)
            pose = poses["ring", shot.name]
            stated = {
                "position_m": pose[:3, 3].tolist(),
                "orientation_xyzw": Rotation.from_matrix(pose[:3, :3]).as_quat().tolist(),
            }
            for stamp_s in (np.min(shot.stamp_s) - STANDS_S, np.max(shot.stamp_s + shot.exposure_s) + STANDS_S):
                lines.write(json.dumps({"stamp_s": float(stamp_s), "base_from_tool": stated}) + "\n")
    return folder / "robot.jsonl"


def run(*words):
    """Standard output of a command of ringpose; errors end the scan, a shot that shows no ring (status 3) does not."""
    print("ringpose", *words, flush=True)
    done = subprocess.run(
        [Path(sys.executable).parent / "ringpose", *map(str, words)], stdout=subprocess.PIPE, check=False
    )
    if done.returncode not in (0, 3):
        sys.exit(done.returncode)
    return done.stdout


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--views", type=int, default=24, help="shots around the ring")
    given = parser.parse_args()
    folder = given.folder
    folder.mkdir(parents=True, exist_ok=True)
    scene = write_scene(folder, given.views)
    run("simulate", scene, "--output", folder / "simulated", "--force")
    rig, robot, shots = write_rig(folder), write_robot_poses(folder, scene), folder / "simulated" / "shots"
    cloud, page = folder / "cloud.ply", folder / "scan.html"
    in_base = ("--robot-poses", robot)
    run("detect", shots, "--rig", rig, "--frame", "base", *in_base, "--still", "--points", cloud, "--force")
    (folder / "poses.jsonl").write_bytes(run("pose", shots, "--rig", rig, "--still"))
    run(
        "view",
        shots,
        "--rig",
        rig,
        "--poses",
        folder / "poses.jsonl",
        "--points",
        cloud,
        *in_base,
        "--html",
        page,
        "--force",
    )
    print(f"{cloud} has the points in the robot's base; open {page} to see them")


if __name__ == "__main__":
    main()
