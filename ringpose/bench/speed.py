"""The limits on speed and accuracy that the detector is built to, measured here and now.

Times are ratios to what runs beside them on the same core, so that the machine does not matter.
"""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from functools import partial
from time import perf_counter

import cv2
import numpy as np

from ringpose.bench.detectors import shot_of
from ringpose.bench.speed_accuracy import accuracy_gates
from ringpose.bench.speed_gates import Gate, GateSection
from ringpose.bench.speed_times import median_times_s, one_core
from ringpose.bench.stripe_images import Kind, StripeImage, stripe_image, switched_frames
from ringpose.detect.peers import DetectorName, detector
from ringpose.detect.pipeline import detect
from ringpose.detect.stripes import find_stripes
from ringpose.geometry.rays import undistorted_pixels
from ringpose.pose.pipeline import estimate_pose
from ringpose.types.detection import BreakPoints
from ringpose.types.image import Shot
from ringpose.types.options import Method
from ringpose.types.rig import Rig

PEER = "x EdgeDrawing"

TIMED_IMAGES = 3
"""Images of a kind that times are taken of; they differ little."""

POSE_PEER = "solvePnP"
"""OpenCV's pose of six points in a plane, the reference of the times of poses."""

MAX_POSE_TIMES = {"paper": 10.0, "paper-constrained": 10.0, "ml": 50.0}
"""In that unit."""

CALLS_A_ROUND = 20
"""A pose takes about a millisecond, so it is timed more often."""

MOVED_PX = 6.0
"""A prediction is off by so much, right and down."""

PoseStream = Callable[[Shot, Rig], object]
"""A shot's pose line, as `ringpose pose` makes it."""


def detection_sections(seeds: int, rounds: int, pose_stream: PoseStream) -> Iterator[GateSection]:
    """Section after section, as soon as each is measured."""
    with one_core():
        yield GateSection(title="straight segments, full frame", gates=segment_gates(rounds))
        yield GateSection(title="image to break points", gates=chain_gates(rounds, pose_stream))
        yield GateSection(title="break points to pose", gates=pose_gates(rounds))
        centers, ends = accuracy_gates(seeds)
        yield GateSection(title=f"stripe centres, {seeds} images of a kind", gates=centers)
        yield GateSection(title=f"break points, {seeds} images of a kind", gates=ends)


def segment_gates(rounds: int) -> list[Gate]:
    """Our line detector, both methods, on black and in clutter."""
    gates = []
    for kind, limit in ((Kind.DARK, 0.15), (Kind.FOIL, 0.20)):
        names = (DetectorName.EDGE_DRAWING, DetectorName.LENGTH, DetectorName.REFINED)
        times_s = dict.fromkeys(map(str, names), 0.0)
        for seed in range(TIMED_IMAGES):
            image = stripe_image(kind, seed).image
            calls = {str(name): partial(detector(name), image) for name in names}
            for name, time_s in median_times_s(calls, rounds).items():
                times_s[name] += time_s
        reference_s = times_s.pop(DetectorName.EDGE_DRAWING)
        gates += [
            Gate(what=f"{name}, {kind}", measured=time_s / reference_s, unit=PEER, most=limit)
            for name, time_s in times_s.items()
        ]
    return gates


def chain_gates(rounds: int, pose_stream: PoseStream) -> list[Gate]:
    """From the image to break points with sigmas, and on to the pose line."""
    times_s: dict[str, float] = {}
    for seed in range(TIMED_IMAGES):
        for name, time_s in median_times_s(_chain_calls(seed, pose_stream), rounds).items():
            times_s[name] = times_s.get(name, 0.0) + time_s
    peer_s = times_s["peer"]
    further_s = (times_s["four"] - times_s["one"]) / 3
    return [
        Gate(what="one frame, all lasers on, full frame", measured=times_s["one"] / peer_s, unit=PEER, most=0.12),
        Gate(what="of that, stripe centres", measured=times_s["centers"] / peer_s, unit=PEER),
        Gate(what="one frame, all lasers on, tracked bands", measured=times_s["bands"] / peer_s, unit=PEER, most=0.08),
        Gate(what="each further frame of a switched shot", measured=further_s / peer_s, unit=PEER, most=0.12),
        Gate(what="with the ring's edges, full frame", measured=times_s["edges"] / peer_s, unit=PEER),
        Gate(what="pose stream", measured=times_s["stream"] / times_s["edges"], unit="x detect alone", most=2.0),
    ]


def _chain_calls(seed: int, pose_stream: PoseStream) -> dict[str, Callable[[], object]]:
    image, frames = switched_frames(Kind.DARK, seed)
    shot, rig = shot_of(image), image.rig
    return {
        "peer": partial(detector(DetectorName.EDGE_DRAWING), image.image),
        "centers": partial(find_stripes, image.image),
        "one": partial(detect, shot, rig, edges=False),
        "bands": partial(detect, shot, rig, edges=False, predicted=moved(exact_break_points(image))),
        "four": partial(detect, switched_shot(frames[1:]), rig, edges=False),
        "edges": partial(detect, shot, rig),
        "stream": partial(pose_stream, shot, rig),
    }


def pose_gates(rounds: int) -> list[Gate]:
    """Each method of pose estimation, beside a call of OpenCV's on six points."""
    image = stripe_image(Kind.DARK, 0)
    points = exact_break_points(image)
    calls: dict[str, Callable[[], object]] = {POSE_PEER: _solve_pnp(image)}
    calls |= {method.value: partial(estimate_pose, points, image.rig, method) for method in Method}
    times_s = median_times_s(calls, rounds * CALLS_A_ROUND)
    reference_s = times_s.pop(POSE_PEER)
    return [
        Gate(what=POSE_PEER, measured=reference_s * 1e3, unit="ms"),
        *(
            Gate(what=name, measured=time_s / reference_s, unit=f"x {POSE_PEER}", most=MAX_POSE_TIMES[name])
            for name, time_s in times_s.items()
        ),
    ]


def start_gates(runs: Mapping[str, Callable[[], object]], rounds: int) -> GateSection:
    """How soon the command is there; the runs are `import numpy, cv2`, `--help` and first pose lines, wall time."""
    times_s = median_times_s(runs, rounds, perf_counter)
    reference = next(iter(runs))
    limits = {name: 1.3 if "--help" in name else 2.0 for name in runs if name != reference}
    gates = [
        Gate(what=name, measured=times_s[name] / times_s[reference], unit=f"x {reference}", most=most)
        for name, most in limits.items()
    ]
    return GateSection(title="start", gates=gates)


def switched_shot(frames: "np.ndarray[tuple[int, int, int], np.dtype[np.uint8]]") -> Shot:
    """Frames without a laser and with each alone, as a shot."""
    count = len(frames)
    return Shot(
        name="switched",
        images=frames,
        lasers=np.array([0, *(1 << laser for laser in range(count - 1))], np.uint8),
        stamp_s=np.arange(count) * 0.1,
        exposure_s=np.full(count, 1e-3),
    )


def exact_break_points(image: StripeImage) -> BreakPoints:
    """The true break points, with the sigmas that detection gives on dark images."""
    ends = np.stack([undistorted_pixels(edges, image.rig.camera) for edges in image.break_points_px])
    return BreakPoints(
        position_px=image.break_points_px,
        covariance_px2=np.tile(np.diag([0.05**2, 0.01**2]), (3, 2, 1, 1)),
        flags=np.zeros((3, 2), np.int64),
        face_start_px=ends[:, 0],
        face_end_px=ends[:, 1],
        face_sigma_px=np.full((3, 2), 0.01),
        labelled=True,
    )


def moved(points: BreakPoints) -> BreakPoints:
    """A prediction that is off by what the ring has moved since."""
    return replace(
        points,
        position_px=points.position_px + MOVED_PX,
        face_start_px=points.face_start_px + MOVED_PX,
        face_end_px=points.face_end_px + MOVED_PX,
    )


def _solve_pnp(image: StripeImage) -> Callable[[], object]:
    """A call of OpenCV's for the pose of six points in a plane."""
    camera = image.rig.camera
    pixels = image.break_points_px.reshape(6, 2)
    flat = (undistorted_pixels(pixels, camera) - camera.camera_matrix[:2, 2]) / camera.camera_matrix[0, 0]
    points = np.column_stack([flat, np.zeros(6)])
    return lambda: cv2.solvePnP(points, pixels, camera.camera_matrix, camera.distortion_coefficients)
