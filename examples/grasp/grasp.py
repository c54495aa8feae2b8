#!/usr/bin/env python3
"""A robot that grasps the ring of a tumbling satellite, guided by `ringpose pose --track`; run.sh starts all of it.

    sh run.sh DIR [--seed N] [--floating] [--distance-m D] [--share S] [--record]

Three programs exchange what they would exchange in a laboratory:

    platform   ringpose simulate serve --images ... --clock lockstep   shows and photographs the ring
    ringpose   ringpose pose --track --camera tcp://... --robot-poses -   measures it in the robot's base
    robot      python3 grasp.py run DIR ADDRESS < tracks > robot-poses   this program: arm, gripper and guidance

The robot is also a client of the platform: before each shot it shows the ring as the camera on its tool will see it
move from the first frame to the lit one, and writes the poses that it reports up to the end of the shot, with their
errors. From the line of the shot, the guidance of `ringpose bench study capture` makes velocities of the tool, until it
closes. The rig that measures, and the mount, differ from the true ones by errors drawn from their covariances.

The outcome against the truth is a line on standard error, and in DIR/captures.jsonl for `ringpose bench capture`; the
exit status is 0 if the gripper closed on the band, 3 if not. A share below 1 makes the pictures smaller, and the whole
faster. With --record the shots of the run, the poses of the robot, the lines and the truth are kept in DIR, and the
console shows them: ringpose view DIR/shots --rig DIR/rig.yaml --tracks DIR/tracks.jsonl --robot-poses DIR/robot.jsonl
"""

import argparse
import json
import queue
import shutil
import socket
import struct
import sys
import threading
from dataclasses import replace
from itertools import chain
from math import degrees, radians
from pathlib import Path
from time import sleep

import numpy as np
import yaml
from scipy.spatial.transform import Rotation

from ringpose.bench.capture.guidance import ring_of_track
from ringpose.bench.capture.loop import run_loop
from ringpose.bench.capture.score import outcome_of
from ringpose.bench.capture.world import SHOT_S, World, tumbling
from ringpose.files.images.shots import write_shot
from ringpose.files.records import captures, line_of, tracks
from ringpose.files.rigs import read_rig, write_rig
from ringpose.files.scenes.motions import mass_properties
from ringpose.files.scenes.scene import read_scene
from ringpose.files.studies.specification import PRESETS
from ringpose.geometry.rotations import rotation_vector
from ringpose.simulate.placement import ring_rotation, ring_views
from ringpose.simulate.stripe_ends import drawn_rig
from ringpose.types.capture import Arm, CaptureLoop, FloatingBase
from ringpose.types.image import Shot
from ringpose.types.scene import Sensor
from ringpose.types.target import FreeMotion
from ringpose.wire.images import PROTOCOL, Header, frame_in, message

HERE = Path(__file__).parent
LOOP = CaptureLoop(gripper_m=np.array([0.0, -0.025, 0.25]), arm=Arm(delay_s=0.1), latency_s=0.12)
"""The gripper closes 0.25 m before the camera. Delay and latency are longer than a shot: the motion in a shot is known
when it begins, and its line comes when it has ended."""

RATE, NUTATION, DRIFT_M_S = radians(1.0), radians(10.0), 0.01
"""Motion of the satellite: degrees a second, half-cone of the nutation, drift."""

ANSWER_S = 20.0
"""Time to wait for the line of a shot; without one the shot counts as lost."""

SETTLE_S = 1.0
"""Time between shots at the start, until `ringpose pose` has connected and writes lines."""


def prepare(folder, seed, distance_m, share):
    """The platform's scene, whose camera is the true one, drawn from the covariance of the rig that measures."""
    folder.mkdir(parents=True, exist_ok=True)
    rig = yaml.safe_load((PRESETS / "capture-rig.yaml").read_text())
    (folder / "rig.yaml").write_text(yaml.safe_dump(with_smaller_pictures(rig, share)))
    true = drawn_rig(read_rig(folder / "rig.yaml"), np.random.default_rng([seed, 1]))
    write_rig(folder / "true-rig.yaml", replace(true, mount=None), force=True)
    scene = yaml.safe_load((HERE / "scene.yaml").read_text())
    scene["rig"], scene["sensor"] = "true-rig.yaml", {"pixel_m": Sensor().pixel_m / share}
    scene["trajectory"][0]["center_m"][2] = distance_m
    (folder / "scene.yaml").write_text(yaml.safe_dump(scene))


def with_smaller_pictures(rig, share):
    """The rig with a camera whose pixels are larger: focal lengths, principal point and their covariance in these."""
    camera = rig["camera"]
    for name in ("image_width", "image_height"):
        camera[name] = round(share * camera[name])
    fx, _, cx, _, fy, cy, *rest = camera["camera_matrix"]["data"]
    center = [share * (value + 0.5) - 0.5 for value in (cx, cy)]  # the first pixel's centre is 0
    camera["camera_matrix"]["data"] = [share * fx, 0.0, center[0], 0.0, share * fy, center[1], *rest]
    scales = np.array([share if name in ("fx", "fy", "cx", "cy") else 1.0 for name in rig["covariance"]["parameters"]])
    rig["covariance"]["data"] = (np.outer(scales, scales) * rig["covariance"]["data"]).tolist()
    return rig


class Platform:
    """A client of the image server that shows the ring in one pose after the other."""

    def __init__(self, address):
        host, _, port = address.removeprefix("tcp://").rpartition(":")
        self._socket = socket.create_connection((host, int(port)))
        self._send({"type": "hello", "protocol": PROTOCOL})
        self.greeting, _ = self._received()

    def show(self, before, after, apart_s, height_m):
        """Show the ring from the next shot on, which begins in the first of two poses and comes to the other one."""
        (rotation, translation_m), (later, later_m) = before, after
        normal = rotation[:, 2]
        roll = ring_rotation(normal, 0.0).T @ rotation
        center_m = translation_m + height_m * normal
        self._send({
            "type": "pose", "center_m": center_m.tolist(), "normal": normal.tolist(),
            "roll_rad": float(np.arctan2(roll[1, 0], roll[0, 0])),
            "velocity_m_s": ((later_m + height_m * later[:, 2] - center_m) / apart_s).tolist(),
            "angular_velocity_rad_s": (rotation_vector(later @ rotation.T) / apart_s).tolist(),
        })  # fmt: skip
        answer, _ = self._received()
        if answer["type"] != "done":
            sys.exit(f"grasp: the platform cannot show it: {answer.get('message')}")

    def exposed(self):
        """The next frame."""
        self._send({"type": "subscribe", "frames": 1})
        header, pixels = self._received()
        return frame_in(Header(header), pixels)

    def begin(self, lines):
        """Let the platform take shots until their lines come; from then on time advances only with this client."""
        while lines.empty():
            while self.exposed().step != len(self.greeting["sequence"]) - 1:
                pass
            sleep(SETTLE_S)

    def _send(self, header):
        self._socket.sendall(message(header))

    def _received(self):
        _, size, payload = struct.unpack(">4sII", self._exactly(12))
        return json.loads(self._exactly(size)), self._exactly(payload)

    def _exactly(self, size):
        parts = bytearray()
        while len(parts) < size:
            part = self._socket.recv(min(1 << 20, size - len(parts)))
            if not part:
                sys.exit("grasp: the platform has gone")
            parts += part
        return bytes(parts)


def lines_of(stream):
    """A queue of the lines that a thread reads, with an empty one at their end."""
    lines = queue.Queue()
    threading.Thread(target=lambda: [lines.put(line) for line in chain(stream, [""])], daemon=True).start()
    return lines


class Recording:
    """What a run was, for `ringpose view`; nothing without a folder."""

    def __init__(self, folder):
        self._folder = folder
        if folder is not None:
            shutil.rmtree(folder / "shots", ignore_errors=True)
            (folder / "shots").mkdir()
            for name in ("robot", "tracks", "truth"):
                (folder / f"{name}.jsonl").write_text("")

    def add(self, name, text):
        """Add lines to the file of this name."""
        if self._folder is not None:
            with (self._folder / f"{name}.jsonl").open("a") as file:
                file.write(text)

    def add_shot(self, frames):
        """Keep a shot and its truth."""
        if self._folder is None:
            return
        shot = Shot(
            name=frames[0].shot,
            images=np.stack([frame.image for frame in frames]),
            lasers=np.array([frame.lasers for frame in frames], np.uint8),
            stamp_s=np.array([frame.stamp_s for frame in frames]),
            exposure_s=np.array([frame.exposure_s for frame in frames]),
        )
        write_shot(self._folder / "shots" / f"{shot.name}.npz", shot)
        self.add("truth", json.dumps(frames[0].truth) + "\n")


def run(folder, address, seed, floating, *, record):
    scene, platform = read_scene(folder / "scene.yaml"), Platform(address)
    scene = replace(scene, rig=read_rig(folder / "rig.yaml"))
    _, center_m, inertia = mass_properties(scene.parts)
    rng = np.random.default_rng([seed, 2])
    free = FreeMotion(inertia_kg_m2=inertia, center_of_mass_m=center_m, angular_velocity_rad_s=np.zeros(3))
    motion = tumbling(free, RATE, NUTATION, DRIFT_M_S, rng)
    frame_s, frames = 1.0 / platform.greeting["rate_hz"], len(platform.greeting["sequence"])
    loop = replace(LOOP, period_s=frames * frame_s)
    world = World(scene, ring_views(scene)[0], motion, loop, FloatingBase() if floating else None, rng)
    lines, reported, middle_s, recording = lines_of(sys.stdin), 0, 0.0, Recording(folder if record else None)

    platform.begin(lines)

    def line_of_shot(time_s):
        """The line of a shot, None if there is none in time, and the time of the platform at which the run begins."""
        nonlocal reported, middle_s
        lit_s = time_s + (frames - 1) * frame_s
        world.advance(lit_s + SHOT_S)  # as long as no later command can have an effect
        shown_s = lit_s + middle_s
        before, after = world.camera_from_target(time_s), world.camera_from_target(shown_s)
        platform.show(before, after, shown_s - time_s, scene.ring.height_m)
        shot = [platform.exposed()]
        begin_s = shot[0].stamp_s - time_s
        for stamp_s, pose in world.reported[reported:]:
            stated = {
                "position_m": pose.position_m.tolist(),
                "orientation_xyzw": Rotation.from_matrix(pose.rotation).as_quat().tolist(),
            }
            text = json.dumps({"stamp_s": begin_s + stamp_s, "base_from_tool": stated}) + "\n"
            sys.stdout.write(text)
            recording.add("robot", text)
        sys.stdout.flush()
        reported = len(world.reported)
        shot += [platform.exposed() for _ in range(1, frames)]
        recording.add_shot(shot)
        middle_s = 0.5 * shot[-1].exposure_s
        try:
            while line := lines.get(timeout=ANSWER_S):
                track = json.loads(line)
                if track["shot"] == shot[0].shot:
                    recording.add("tracks", line)
                    return tracks.RECORD.read(track, "track"), begin_s
        except queue.Empty:
            return None, begin_s
        sys.exit("grasp: the lines have ended: see the message of ringpose pose")

    def measure(number, time_s):
        track, begin_s = line_of_shot(time_s)
        ring = None if track is None else ring_of_track(track)
        return None if ring is None else ring.earlier(begin_s)

    done = run_loop(world, measure, loop.latency_s).line(f"seed {seed}", "track", {"floating_base": floating})
    with (folder / "captures.jsonl").open("a") as file:
        file.write(line_of(captures.RECORD.write(done)))
    scored = outcome_of(done)
    errors = (
        f"{1e3 * scored.radial_m:.2f} mm and {degrees(scored.tilt_rad):.2f} degrees off"
        if done.is_closed
        else done.reason
    )
    print(f"grasp: {scored.outcome} after {done.closed_s:.1f} s: {errors}", file=sys.stderr)
    return 0 if scored.outcome == "success" else 3


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("do", choices=["prepare", "run"])
    parser.add_argument("folder", type=Path)
    parser.add_argument("address", nargs="?", help="tcp://HOST:PORT of the platform")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--distance-m", type=float, default=1.0, help="of the ring's face at the start")
    parser.add_argument("--share", type=float, default=1.0, help="size of the pictures, as a share of 1600 x 1200")
    parser.add_argument("--floating", action="store_true", help="the base floats freely")
    parser.add_argument("--record", action="store_true", help="keep the shots and lines of the run, for ringpose view")
    given = parser.parse_args()
    if given.do == "prepare":
        prepare(given.folder, given.seed, given.distance_m, given.share)
        return 0
    return run(given.folder, given.address, given.seed, given.floating, record=given.record)


if __name__ == "__main__":
    sys.exit(main())
