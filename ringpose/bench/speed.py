"""Processor times of detection and pose estimation on this machine, relative to reference functions of OpenCV."""

import math
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from functools import partial
from statistics import median
from time import process_time

import cv2
import numpy as np

from ringpose.detect.pipeline import detect
from ringpose.pose.pipeline import estimate_pose
from ringpose.types.detection import BreakPoints
from ringpose.types.image import Shot
from ringpose.types.options import Method
from ringpose.types.rig import Camera, LaserPlanes, Rig

Clock = Callable[[], float]

POSES_PER_ROUND = 20
"""A pose takes about a millisecond, so it is timed more often than a detection."""

RIM_RADII_M, RIM_DEPTH_M, BODY_DEPTH_M = (0.567, 0.597), 0.6, 0.66
FOCAL_LENGTH_PX, IMAGE_SIZE, PRINCIPAL_POINT = 1778.0, (1600, 1200), (800.0, 600.0)
LASER_DISTANCE_M, LASER_ANGLE_RAD = (-0.0394, -0.07, -0.0394), math.radians(10)
STRIPE_PEAK_DN, STRIPE_SIGMA_PX = 170.0, 2.5


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
    shot, rig = drawn_shot()
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
    shot, rig = drawn_shot()
    points = detect(shot, rig, edges=False).break_points
    assert isinstance(points, BreakPoints)  # the drawn ring is in full view
    calls: dict[str, Callable[[], object]] = {"solvePnP": solve_pnp(points, rig.camera)}
    calls |= {f"pose, {method}": partial(estimate_pose, points, rig, method) for method in Method}
    with one_core():
        return median_times_s(calls, rounds * POSES_PER_ROUND)


def solve_pnp(points: BreakPoints, camera: Camera) -> Callable[[], object]:
    """A call of solvePnP with the break points, and the same points in a plane parallel to the image as object."""
    pixels = points.position_px.reshape(-1, 2)
    flat = (pixels - camera.camera_matrix[:2, 2]) / camera.camera_matrix[0, 0]
    objects = np.column_stack([flat, np.zeros(len(flat))])
    return lambda: cv2.solvePnP(objects, pixels, camera.camera_matrix, camera.distortion_coefficients)


def drawn_shot() -> tuple[Shot, Rig]:
    """One frame, three lasers on, of a ring parallel to the image, whose stripes are therefore horizontal.

    The rim interrupts each stripe on the body behind it; 12 px beside the rim are in its shadow.
    """
    rig = _rig()
    (width, height), (x0, y0) = IMAGE_SIZE, PRINCIPAL_POINT
    x, y = np.arange(width), np.arange(height)[:, None]
    light = np.zeros((height, width))
    for normal, distance_m in zip(rig.lasers.normal, rig.lasers.distance_m, strict=True):
        y_m = (distance_m - normal[2] * RIM_DEPTH_M) / normal[1]  # normal @ (x, y, z) = distance
        center_x_m = RIM_RADII_M[1] - 0.06
        rim_x = [x0 + FOCAL_LENGTH_PX * (center_x_m - math.sqrt(r**2 - y_m**2)) / RIM_DEPTH_M for r in RIM_RADII_M]
        inner, outer = max(rim_x), min(rim_x)
        on_rim, on_body = (x > outer) & (x < inner), (x < outer - 12) | (x > inner + 12)
        for depth_m, lit in ((RIM_DEPTH_M, on_rim), (BODY_DEPTH_M, on_body)):
            row = y0 + FOCAL_LENGTH_PX * (distance_m - normal[2] * depth_m) / normal[1] / depth_m
            light += STRIPE_PEAK_DN * np.exp(-0.5 * ((y - row) / STRIPE_SIGMA_PX) ** 2) * lit
    noise = np.random.default_rng(0).normal(size=light.shape) * np.sqrt(1.5**2 + 0.05 * light)
    image = np.clip(np.rint(light + noise), 0, 255).astype(np.uint8)
    shot = Shot(
        name="drawn",
        images=image[None],
        lasers=np.array([0b111], np.uint8),
        stamp_s=np.zeros(1),
        exposure_s=np.full(1, 1e-3),
    )
    return shot, rig


def _rig() -> Rig:
    """Three lasers above the camera; the outer planes are tilted by 10 degrees against each other's mean."""
    sine, cosine = math.sin(LASER_ANGLE_RAD), math.cos(LASER_ANGLE_RAD)
    (width, height), (x0, y0) = IMAGE_SIZE, PRINCIPAL_POINT
    return Rig(
        camera=Camera(
            camera_name="drawn",
            image_width=width,
            image_height=height,
            camera_matrix=np.array([[FOCAL_LENGTH_PX, 0.0, x0], [0.0, FOCAL_LENGTH_PX, y0], [0.0, 0.0, 1.0]]),
            distortion_model="plumb_bob",
            distortion_coefficients=np.zeros(5),
        ),
        lasers=LaserPlanes(
            names=("left", "middle", "right"),
            normal=np.array([[0.0, cosine, -sine], [0.0, 1.0, 0.0], [0.0, cosine, sine]]),
            distance_m=np.array(LASER_DISTANCE_M),
            projector_m=np.full((3, 3), np.nan),
        ),
    )
