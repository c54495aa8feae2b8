"""Tracks of images against truth: rendered tumbling targets, and live play-back.

`live` plays rendered frames by the virtual GigE camera into `ringpose pose --camera --track`, by this
computer's clock. One line a figure.
"""

import contextlib
import io
import json
import sys
import tempfile
import time
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import chain
from multiprocessing import Pipe, Process
from multiprocessing.connection import Connection
from pathlib import Path

import cv2
import numpy as np
import yaml
from benchmarks.limits import WRONG_SIGMAS, Figure, band, status, target
from moving_rings import START_S
from ring_scenes import Ring
from tracked_rings import DEGREES_OF_FREEDOM, errors_at, nees_at

from ringpose.cli.main import main as ringpose
from ringpose.files.scenes.scene import read_scene
from ringpose.measure.stream import Setup, Stream, track_options
from ringpose.optics.sensor import digitised
from ringpose.simulate.motion import velocities
from ringpose.simulate.pipeline import render_ring_view, simulated_shot
from ringpose.simulate.placement import ring_views
from ringpose.simulate.serve.device import ServedCamera
from ringpose.simulate.serve.genicam import Identity
from ringpose.simulate.serve.relays import RelayContacts
from ringpose.types.assumptions import AssumptionOptions
from ringpose.types.scene import Scene

RIG = Path(__file__).parents[2] / "examples" / "scene-rig.yaml"

SCENE = {
    "ringpose": "scene/1",
    "start_s": START_S,
    "stripe_dn": 170,
    "ring": {"radius_inner_m": 0.567, "radius_outer_m": 0.597, "height_m": 0.06},
    "body": {"size_m": [1.6, 1.6, 1.0]},
}

SHOTS_HZ = 6.0

GRASP_WRONG_M = 0.005


@dataclass(frozen=True)
class Path3D:
    """The motion of a scene's ring."""

    scene: Scene

    def at(self, time_s: float) -> Ring:
        rotation, translation_m = ring_views(self.scene)[0].path.camera_from_target(time_s)
        ring = self.scene.ring
        return Ring(
            center_m=rotation @ [0.0, 0.0, ring.height_m] + translation_m,
            normal=rotation[:, 2],
            radius_m=np.array([ring.radius_inner_m, ring.radius_outer_m]),
        )

    def velocity_at(self, time_s: float) -> np.ndarray:
        face_m = np.array([0.0, 0.0, self.scene.ring.height_m])
        return velocities(ring_views(self.scene)[0].path, time_s, face_m)[0]


def scene_of(folder: Path, width: int, **keys) -> Scene:
    """A scene with these keys, read as a scene file, with the example's rig scaled to images of this width."""
    rig = yaml.safe_load(RIG.read_text())
    camera, matrix = rig["camera"], np.array(rig["camera"]["camera_matrix"]["data"]).reshape(3, 3)
    factor = width / camera["image_width"]
    matrix[:2] *= factor
    matrix[:2, 2] += (factor - 1.0) / 2.0
    camera["image_width"], camera["image_height"] = width, round(factor * camera["image_height"])
    camera["camera_matrix"]["data"] = matrix.ravel().tolist()
    (folder / "rig.yaml").write_text(yaml.safe_dump(rig, sort_keys=False))
    sensor = {"pixel_m": 9.0e-6 / factor}
    (folder / "scene.yaml").write_text(yaml.safe_dump({**SCENE, "rig": "rig.yaml", "sensor": sensor, **keys}))
    return read_scene(folder / "scene.yaml")


def tumbling_scene(folder: Path, rate_deg_s: float, light_w_m2: float, rng) -> Scene:
    """A body that precesses about an axis 20 degrees from the ring's, whose centre of mass is 1 m behind the ring."""
    direction = rng.uniform(0.0, 2.0 * np.pi)
    axis = np.array([np.sin(np.radians(20.0)), 0.0, np.cos(np.radians(20.0))])
    turned = [axis[0] * np.cos(direction), axis[0] * np.sin(direction), axis[2] / 1.6]
    pose = {"name": "run", "center_m": [-0.582, 0.0, 0.5], "pitch_rad": 0.0, "yaw_rad": 0.0, "light": "lit"}
    motion = {
        "angular_velocity_rad_s": (np.radians(rate_deg_s) * rng.choice([-1, 1]) * np.array(turned)).tolist(),
        "velocity_m_s": (0.01 * rng.normal(size=3)).tolist(),
        "center_of_mass_m": [0.0, 0.0, -1.0],
        "inertia_kg_m2": [1.0, 1.0, 1.6],
        "shots": int(3 * SHOTS_HZ),
    }
    return scene_of(
        folder,
        1600,
        sequence="off,1,2,3,off",
        exposure_s=0.004,
        seed=int(rng.integers(1 << 30)),
        period_s=1.0 / SHOTS_HZ,
        lights={"lit": {"ambient_w_m2": light_w_m2}},
        trajectory=[pose],
        motion=motion,
    )


def rendered(rng, folder: Path) -> Iterator[Figure]:
    """Five rendered runs of 3 s, 1 to 8 degrees a second, with --max-speed 0.2 --max-rate 8."""
    assumed = AssumptionOptions(max_speed_m_s=0.2, max_rate_deg_s=8.0)
    squares: dict[str, list[float]] = {}
    grasps_m, used, shots = [], 0, 0
    for rate_deg_s, light_w_m2 in zip((1.0, 2.0, 4.0, 6.0, 8.0), (0.0, 0.3, 0.0, 0.3, 0.0), strict=True):
        scene = tumbling_scene(folder, rate_deg_s, light_w_m2, rng)
        stream, truth = Stream(Setup(rig=scene.rig, options=assumed), track_options(assumed)), Path3D(scene)
        views = ring_views(scene)
        for number in range(len(views)):
            at = stream.measure(simulated_shot(scene, views, number)[0]).track
            used += at.attempt.fusion_status == "fused"
            shots += 1
            if number < 2 or at.pose is None or not np.isfinite(at.pose.center_m).all():
                continue
            for name, value in nees_at(truth, at).items():
                squares.setdefault(name, []).append(value * DEGREES_OF_FREEDOM[name])
            grasps_m.append(float(np.linalg.norm(errors_at(truth, at)["grasp"][0])))
    yield from scores(squares, grasps_m, 5, "five rendered runs, 1 to 8 deg/s")
    yield target("share of shots used, five rendered runs", used / shots, 1.0, 0.9)


def scores(squares: dict[str, list[float]], grasps_m: list[float], runs: int, where: str) -> Iterator[Figure]:
    """NEES of each quantity and the number of wrong ones; lines of one run are correlated, bands are those of runs."""
    every = [value for values in squares.values() for value in values]
    wrong = sum(value > WRONG_SIGMAS**2 for value in every) + sum(each > GRASP_WRONG_M for each in grasps_m)
    yield target(f"wrong of {len(every)} quantities, {where}", wrong, 0)
    for name, values in squares.items():
        value = float(np.mean(values)) / DEGREES_OF_FREEDOM[name]
        yield target(f"NEES of {name}, {where}", value, band(runs, DEGREES_OF_FREEDOM[name])[1])
    yield target(f"grasp point, rms in mm, {where}", 1e3 * float(np.sqrt(np.mean(np.square(grasps_m)))), 1.0)


class Playback:
    """Plays rendered frames by this computer's clock from the first exposure; between two views they are mixed.

    The grey values of each view are computed in advance, with all lasers off, each one on, and all on.
    """

    def __init__(self, views, rate_hz: float, contacts: RelayContacts) -> None:
        self.rate_hz, self.contacts, self.began_s = rate_hz, contacts, None
        self.exposed: list[tuple[float, tuple[float, ...]]] = []
        generator, lasers = np.random.default_rng(1), range(len(contacts.shares(0.0, 1.0)))
        masks = [0, *(1 << laser for laser in lasers), (1 << len(lasers)) - 1]
        self.frames = []
        for view in views:
            by_mask = {}
            for mask in masks:
                electrons = view.electrons_with([mask >> laser & 1 for laser in lasers], EXPOSURE_S, 0.0)
                by_mask[mask] = digitised(electrons, view.sensor, generator)
            self.frames.append(by_mask)

    def image(self, began_s, exposure_s, gain_db, bits):
        """See `ExposedImage`."""
        self.began_s = began_s if self.began_s is None else self.began_s
        number = (began_s + exposure_s / 2 - self.began_s) * self.rate_hz
        first = min(int(number), len(self.frames) - 2)
        shares, mixed = self.contacts.shares(began_s, began_s + exposure_s), min(number - first, 1.0)
        self.exposed.append((began_s, shares))
        mask = sum(1 << laser for laser, share in enumerate(shares) if share > 0.5)
        frames = [each[mask] for each in self.frames[first : first + 2]]
        return cv2.addWeighted(frames[0], 1.0 - mixed, frames[1], mixed, 0.0), {}


PLAYED_HZ, PLAYED_S, EXPOSURE_S, PLAYED_WIDTH = 30.0, 4.0, 0.004, 800

ADDRESS, JUMBO_BYTES = "127.0.0.31", 16260
"""Of the virtual camera; it sends large packets, because a frame of small ones takes it 20 ms of processor time."""


def played_scene(folder: Path, width: int) -> Scene:
    """A slow motion, one view for each thirtieth of a second."""
    pose = {"name": "run", "center_m": [-0.582, -0.02, 0.5], "pitch_rad": 0.0, "yaw_rad": 0.0, "light": "dim"}
    motion = {"angular_velocity_rad_s": [0.01, 0.008, 0.0], "velocity_m_s": [0.01, 0.0, 0.01]}
    motion |= {"center_of_mass_m": [0, 0, -0.5], "inertia_kg_m2": [1, 1, 1], "shots": int(PLAYED_HZ * PLAYED_S)}
    timing = {"sequence": "all", "exposure_s": EXPOSURE_S, "period_s": 1.0 / PLAYED_HZ}
    return scene_of(folder, width, **timing, lights={"dim": {"ambient_w_m2": 0.3}}, trajectory=[pose], motion=motion)


def play(scene: Scene, control: Connection) -> None:
    """Render the views and serve them, as another process; reports the exposures at the end."""
    lasers = range(len(scene.rig.lasers.names))
    views = (render_ring_view(scene, view, k) for k, view in enumerate(ring_views(scene)))
    contacts = RelayContacts(len(lasers))
    playback = Playback(views, PLAYED_HZ, contacts)

    def lines_changed(high: int, now_s: float) -> None:
        for laser in lasers:
            contacts.command(laser, bool(high >> laser & 1), now_s)

    size = {"width": scene.rig.camera.image_width, "height": scene.rig.camera.image_height}
    identity = Identity(address=ADDRESS, **size, bits=8, exposure_s=EXPOSURE_S, serial="PLAY")
    with ServedCamera(identity, playback.image, None, lines_changed):
        control.send("ready")
        control.recv()
    control.send((playback.began_s, playback.exposed))


class TimedOutput(io.StringIO):
    """Notes when each line is written, by the host's clock."""

    def __init__(self) -> None:
        super().__init__()
        self.written_s: list[float] = []

    def write(self, text: str) -> int:
        self.written_s += [time.time()] * text.count("\n")
        return super().write(text)


def live(folder: Path) -> Iterator[Figure]:
    """`pose --camera aravis: --track` of a virtual GigE camera, in another process, that plays rendered frames."""
    scene = played_scene(folder, PLAYED_WIDTH)
    here, there = Pipe()
    camera = Process(target=play, args=(scene, there), daemon=True)
    camera.start()
    here.recv()
    camera_uri = f"aravis://{ADDRESS}?packet={JUMBO_BYTES}"
    words = ["pose", "--track", "--rig", str(folder / "rig.yaml"), "--camera", camera_uri]
    words += ["--lasers", "line:Line1,Line2,Line3", "--duration", str(PLAYED_S - 0.5), "--quiet"]
    busy_s = -time.process_time()
    with contextlib.redirect_stdout(TimedOutput()) as out:
        status_of_pose = ringpose(words)
    busy_s += time.process_time()
    here.send("end")
    began_s, exposed = here.recv()
    camera.join()
    began_s += time.time() - time.monotonic()  # of the host's clock
    truth, records = Path3D(scene), [json.loads(line) for line in out.getvalue().splitlines()]
    squares = []
    for record in records[3:]:
        error_m = np.array(record["pose"]["center_m"]) - truth.at(record["stamp_s"] - began_s).center_m
        squares.append(float(error_m @ np.linalg.solve(record["pose"]["covariance"]["center"], error_m)))
    followed_from = len(records) // 3
    followed = np.array([record["stamp_s"] for record in records[followed_from:]])
    gaps, late_s = np.diff(followed), np.array(out.written_s[followed_from:]) - followed - EXPOSURE_S / 2
    fused = sum(record["fusion_status"] == "fused" for record in records)
    lit = [sum(share > 0.5 for share in shares) for _, shares in exposed]
    where = f"live, {PLAYED_WIDTH} px wide"
    frames = f"{len(lit)} frames ({lit.count(0)} off, {lit.count(1)} with one laser)"
    yield target(f"exit status, {where}", status_of_pose, 0)
    yield target(f"frames with all lasers of {frames}, {where}", lit.count(3), np.inf, 1)
    yield target(f"records fused of {len(records)}, {where}", fused, np.inf, len(records) - 1)
    yield target(f"largest chi-squared of the centre, {where}", max(squares), WRONG_SIGMAS**2)
    yield target(f"poses a second (median interval), {where}", 1.0 / np.median(gaps), np.inf, 30.0)
    yield target(f"processor time of a pose in ms, {where}", 1e3 * busy_s / len(records), 1e3 / PLAYED_HZ)
    for share in (0.5, 0.99):
        late_ms = 1e3 * np.quantile(late_s, share)
        name = f"ms from the end of an exposure to the line, quantile {share:g}, {where}"
        yield target(name, late_ms, 2e3 / PLAYED_HZ)
    missed = np.round(gaps * PLAYED_HZ - 1.0).clip(0).sum()
    periods = round((followed[-1] - followed[0]) * PLAYED_HZ)
    yield target(f"periods of 1/30 s without a pose of {periods}, {where}", missed, 0.1 * periods)


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as name:
        sys.exit(status(chain(rendered(np.random.default_rng(18), Path(name)), live(Path(name)))))
