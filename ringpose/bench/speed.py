"""Processor times of detection and pose estimation on this machine, relative to reference functions of OpenCV."""

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from statistics import median
from time import process_time

import cv2
import numpy as np

from ringpose.bench.design.maps import Place, scene_at
from ringpose.detect.pipeline import detect
from ringpose.files.scenes.scene import read_scene
from ringpose.files.studies.specification import PRESETS
from ringpose.pose.pipeline import estimate_pose
from ringpose.simulate.pipeline import simulated_shot
from ringpose.types.detection import BreakPoints
from ringpose.types.image import Shot
from ringpose.types.options import Method
from ringpose.types.rig import Camera, Rig

Clock = Callable[[], float]

POSES_PER_ROUND = 20
"""A pose takes about a millisecond, so it is timed more often than a detection."""


def median_times_s(
    calls: Mapping[str, Callable[[], object]], rounds: int, clock: Clock = process_time
) -> dict[str, float]:
    """Median seconds of each call, after one call to warm up, in rounds in which each runs once.

    The default clock is the processor time of all threads of this process: other processes have no influence, and
    additional threads do not shorten it.
    """
    times: dict[str, list[float]] = {name: [] for name in calls}
    for call in calls.values():
        call()
    for _ in range(rounds):
        for name, call in calls.items():
            start = clock()
            call()
            times[name].append(clock() - start)
    return {name: median(every) for name, every in times.items()}


@contextmanager
def one_core() -> Iterator[None]:
    """Run OpenCV in the calling thread only while the block runs."""
    threads = cv2.getNumThreads()
    cv2.setNumThreads(1)
    try:
        yield
    finally:
        cv2.setNumThreads(threads)


def detection_times_s(rounds: int) -> dict[str, float]:
    """Times of EdgeDrawing (edges and lines), the reference, and of the detection of one frame with all lasers on."""
    shot, rig = rendered_shot()
    drawing = cv2.ximgproc.createEdgeDrawing()

    def edge_drawing() -> None:
        drawing.detectEdges(shot.images[0])
        drawing.detectLines()

    calls: dict[str, Callable[[], object]] = {
        "EdgeDrawing": edge_drawing,
        "stripes to break points": partial(detect, shot, rig, edges=False),
        "the same with ring edges": partial(detect, shot, rig),
    }
    with one_core():
        return median_times_s(calls, rounds)


def pose_times_s(rounds: int) -> dict[str, float]:
    """Median times of a call in seconds, by name: each method of pose estimation, and the reference.

    The reference is OpenCV's solvePnP on six coplanar points.
    """
    shot, rig = rendered_shot()
    points = detect(shot, rig, edges=False).break_points
    assert isinstance(points, BreakPoints)  # the ring is in full view
    calls: dict[str, Callable[[], object]] = {"solvePnP": solve_pnp(points, rig.camera)}
    calls |= {f"pose, {method}": partial(estimate_pose, points, rig, method) for method in Method}
    with one_core():
        return median_times_s(calls, rounds * POSES_PER_ROUND)


def solve_pnp(points: BreakPoints, camera: Camera) -> Callable[[], object]:
    """A function that calls solvePnP with the break points as image points.

    The object points are the same points in a plane parallel to the image.
    """
    pixels = points.position_px.reshape(-1, 2)
    flat = (pixels - camera.camera_matrix[:2, 2]) / camera.camera_matrix[0, 0]
    objects = np.column_stack([flat, np.zeros(len(flat))])
    return lambda: cv2.solvePnP(objects, pixels, camera.camera_matrix, camera.distortion_coefficients)


def rendered_shot() -> tuple[Shot, Rig]:
    """One frame of 1600 x 1200 pixels, all lasers on: a ring half a metre from the paper's physical rig."""
    scene = replace(read_scene(PRESETS / "paper-physical-scene.yaml"), sequence=(0b111,), body=None)
    at_place = scene_at(scene, Place(distance_m=0.5))
    shot, _ = simulated_shot(at_place, at_place.views, 0)
    return shot, scene.rig
