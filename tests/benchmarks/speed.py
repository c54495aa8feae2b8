"""Every limit of the design on speed and accuracy, measured on this machine (`make bench-speed`).

    PYTHONPATH=tests python -m benchmarks.speed [--seeds N] [--chart FILE]    status 3 if a limit is missed

Times are processor times, as ratios to a reference that runs in the same rounds on the same core, so that they hold on
a busy machine, too. Times by the clock are judged on an idle machine only. `--chart` draws where the time of a shot
goes.

The time from an image to break points with sigmas is that of `detect` without its last step, the judgement by the
estimator whether they lie on one ring.
"""

import sys
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import partial
from itertools import count
from math import inf
from pathlib import Path
from tempfile import TemporaryDirectory
from time import perf_counter

import numpy as np
import yaml
from benchmarks.accuracy import accuracy_figures, pose_accuracy
from benchmarks.frames import ALL, FULL_SCENE, LIGHTS, START_S, SWITCHED, rendered_frames
from benchmarks.limits import Figure, options, printed
from benchmarks.machine import is_idle, machine
from benchmarks.opencv_detectors import DetectorName, detector
from benchmarks.stages import draw_stages, stage_times_s
from benchmarks.stripe_images import (
    Kind,
    exact_break_points,
    moved,
    shot_of,
    stripe_image,
    switched_frames,
    switched_shot,
)
from benchmarks.timing import POSES_PER_ROUND, median_times_s, one_core, solve_pnp, start_calls

from ringpose.detect.break_points import without_outliers
from ringpose.detect.pipeline import Prior, detect
from ringpose.files.records import line_of
from ringpose.files.records.poses import pose_record
from ringpose.files.records.tracks import track_record
from ringpose.files.scenes.scene import read_scene
from ringpose.measure.stream import Setup, Stream, estimate_pose, pose_line, track_options
from ringpose.optics.sensor import digitised
from ringpose.simulate.pipeline import illuminated_ring, moving_frame, render_ring_view
from ringpose.simulate.placement import ring_views
from ringpose.simulate.renderer import layers, pixel_rays
from ringpose.track.explanations import TrackOptions
from ringpose.track.pipeline import Tracker
from ringpose.types.arrays import Array, Float32, Float64
from ringpose.types.assumptions import USUAL
from ringpose.types.detection import BreakPoints, Detection
from ringpose.types.image import Shot
from ringpose.types.options import Method
from ringpose.types.rig import Camera, Rig
from ringpose.types.scene import Scene

SCENE = Path(__file__).parents[2] / "examples" / "scene.yaml"
EDGE_DRAWING, SOLVE_PNP = "x EdgeDrawing", "x solvePnP"

TIMED_IMAGES = 3
"""Images of each kind that are timed; they differ little."""

MAX_POSE_TIMES = {"paper": 8.0, "paper-constrained": 8.0, "ml": 15.0, "judgement": inf, "track step": 5.0}

ROUNDS = 20
"""Rounds in which the calls that are compared take turns."""

MAX_BREAK_POINTS = {"full frame": 0.31, "tracked bands": 0.2}
"""From an image with all lasers on to break points, in times of EdgeDrawing, and ..."""

MAX_BEFORE_FOIL = {
    (Kind.FOIL, "full frame"): 0.44,
    (Kind.BRIGHT_FOIL, "full frame"): inf,
    (Kind.BRIGHT_FOIL, "tracked bands"): 0.4,
}
"""... where it differs."""

MAX_TRACKED, MAX_SWITCHED = {"dark": 0.7, "light": 1.1}, {"dark": 1.2, "light": 2.0}
"""From the decoded frames of a shot to its written line: of a track with all lasers on, and with switched lasers."""

SAMPLED_SHOTS = {"tracked": 100, "switched": 40}
"""Shots from which the stages are sampled."""

TRACKED_SHOTS = 10
"""Shots of a track that are timed together: the last of them has a frame without lasers, too."""

PREDICTED_SIGMA_PX = 6.0
"""Standard deviation of a predicted stripe, which is as far as the predictions are off."""


def sections(seeds: int, chart: Path | None, *, idle: bool) -> Iterator[tuple[str, list[Figure]]]:
    """Titles and figures, each as soon as they are measured; the chart of the stages goes into a file."""
    with one_core():
        yield "segments of the paper's detector, full frame", segment_figures(ROUNDS)
        yield "image to break points and pose record", chain_figures(ROUNDS)
        yield "decoded frames to written line", line_figures(ROUNDS)
        bars = stage_bars()
        if chart is not None:
            draw_stages(bars, chart)
        yield "decoded frames to written line, by stage", bar_figures(bars)
        yield "break points to pose", pose_figures(ROUNDS)
        yield "pose record to JSON", record_figures(ROUNDS)
        yield "rendered frame", rendering_figures(ROUNDS, idle=idle)
    with TemporaryDirectory() as folder:
        image = stripe_image(Kind.DARK, 0)
        calls = start_calls(Path(folder), shot_of(image), image.rig)
        yield "start", start_figures(calls, ROUNDS, idle=idle)
    yield "rendered frame against 256 samples a pixel", fidelity_figures()
    centers, ends = accuracy_figures(seeds)
    yield f"stripe centres, {seeds} images of each kind", centers
    yield f"break points, {seeds} images of each kind", ends
    yield "pose", pose_accuracy(samples=25 * seeds)


def segment_figures(rounds: int) -> list[Figure]:
    """Both methods of the segment detector, on black and in clutter."""
    figures = []
    for kind, limit in ((Kind.DARK, 0.15), (Kind.FOIL, 0.20)):
        names = (DetectorName.EDGE_DRAWING, DetectorName.LENGTH, DetectorName.REFINED)
        times_s = dict.fromkeys(map(str, names), 0.0)
        for seed in range(TIMED_IMAGES):
            image = stripe_image(kind, seed).image
            calls = {str(name): partial(detector(name), image) for name in names}
            for name, time_s in median_times_s(calls, rounds).items():
                times_s[name] += time_s
        reference_s = times_s.pop(DetectorName.EDGE_DRAWING)
        figures += [
            Figure(name=f"{name}, {kind}", measured=time_s / reference_s, unit=EDGE_DRAWING, max_value=limit)
            for name, time_s in times_s.items()
        ]
    return figures


def chain_figures(rounds: int) -> list[Figure]:
    """From the image to break points with covariance, of every kind of image, and on to the pose record."""
    figures = []
    for kind in Kind:
        times_s = _chain_times_s(kind, rounds)
        limits = {name: MAX_BEFORE_FOIL.get((kind, name), usual) for name, usual in MAX_BREAK_POINTS.items()}
        figures += [
            Figure(
                name=f"{kind}: {name}",
                measured=(times_s[name] - times_s["judgement"]) / times_s["reference"],
                unit=EDGE_DRAWING,
                max_value=limit,
            )
            for name, limit in limits.items()
        ]
    times_s = _chain_times_s(Kind.DARK, rounds, switched=True)
    judged_s = times_s["judgement, switched"] - times_s["judgement"]
    further_s = (times_s["switched"] - times_s["full frame"] - judged_s) / 3
    figures.append(
        Figure(
            name="each further frame of a switched shot",
            measured=further_s / times_s["reference"],
            unit=EDGE_DRAWING,
        )
    )
    stream = times_s["stream"] / times_s["with the ring's edges"]
    return [*figures, Figure(name="pose stream", measured=stream, unit="x detect alone", max_value=2.0)]


def _chain_times_s(kind: Kind, rounds: int, *, switched: bool = False) -> dict[str, float]:
    """Times of the stages, summed over images of a kind; `switched` adds switched shots and the whole stream."""
    total_s: dict[str, float] = {}
    for seed in range(TIMED_IMAGES):
        image, frames = switched_frames(kind, seed)
        shot, rig = shot_of(image), image.rig
        predicted = moved(exact_break_points(image), PREDICTED_SIGMA_PX)
        predicted = replace(predicted, face_sigma_px=np.full((3, 2), PREDICTED_SIGMA_PX))
        calls: dict[str, Callable[[], object]] = {
            "reference": partial(detector(DetectorName.EDGE_DRAWING), image.image),
            "full frame": partial(detect, shot, rig, edges=False),
            "tracked bands": partial(detect, shot, rig, Prior(predicted=predicted), edges=False),
            "judgement": _judgement(shot, rig),
        }
        if switched:
            one_by_one = switched_shot(frames[1:])
            calls |= {
                "switched": partial(detect, one_by_one, rig, edges=False),
                "judgement, switched": _judgement(one_by_one, rig),
                "with the ring's edges": partial(detect, shot, rig),
                "stream": partial(_pose_record, shot, rig),
            }
        for name, time_s in median_times_s(calls, rounds).items():
            total_s[name] = total_s.get(name, 0.0) + time_s
    return total_s


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LineCalls:
    """What is timed from the decoded frames of one light to written lines."""

    reference: Callable[[], object]
    """EdgeDrawing on a frame with all lasers on."""
    tracked: Callable[[], str]
    """The line of the next shot of a track."""
    switched: Callable[[], str]
    """The line of a shot by itself that switches the lasers."""


def line_calls(light: str) -> LineCalls:
    """The calls in one light, after the first shots of the track."""
    frames = rendered_frames(light)
    stream, shots = Stream(Setup(rig=frames.rig), track_options(USUAL)), frames.tracked()
    switched = frames.shot(0, SWITCHED, START_S)

    def tracked() -> str:
        measured = stream.measure(next(shots))
        assert measured.track is not None
        return line_of(track_record(measured.track))

    for _ in range(2 * TRACKED_SHOTS):
        tracked()
    return LineCalls(
        reference=partial(detector(DetectorName.EDGE_DRAWING), frames.of_mask[ALL[0]][0]),
        tracked=tracked,
        switched=partial(_pose_record, switched, frames.rig),
    )


def line_figures(rounds: int) -> list[Figure]:
    """From decoded frames to a written line, of a tracked shot and of one that switches the lasers, in both lights."""
    figures = []
    for light in LIGHTS:
        calls = line_calls(light)

        def tracked(one: Callable[[], str] = calls.tracked) -> None:
            for _ in range(TRACKED_SHOTS):
                one()

        times_s = median_times_s({"reference": calls.reference, "tracked": tracked, "switched": calls.switched}, rounds)
        measured = {"tracked": times_s["tracked"] / TRACKED_SHOTS, "switched": times_s["switched"]}
        limits = {"tracked": MAX_TRACKED[light], "switched": MAX_SWITCHED[light]}
        figures += [
            Figure(
                name=f"{name} shot, {light}",
                measured=time_s / times_s["reference"],
                unit=EDGE_DRAWING,
                max_value=limits[name],
            )
            for name, time_s in measured.items()
        ]
    return figures


def stage_bars() -> dict[str, dict[str, float]]:
    """Processor time of each stage of the same shots, in times of EdgeDrawing."""
    bars = {}
    for light in LIGHTS:
        calls = line_calls(light)
        reference_s = median_times_s({"reference": calls.reference}, ROUNDS)["reference"]
        for name, call in (("tracked", calls.tracked), ("switched", calls.switched)):
            times_s = stage_times_s(call, SAMPLED_SHOTS[name])
            bars[f"{name}, {light}"] = {stage: time_s / reference_s for stage, time_s in times_s.items()}
    return bars


def bar_figures(bars: Mapping[str, Mapping[str, float]]) -> list[Figure]:
    """The parts of the bars as figures."""
    return [
        Figure(name=f"{name}: {stage}", measured=share, unit=EDGE_DRAWING)
        for name, parts in bars.items()
        for stage, share in parts.items()
    ]


def _judgement(shot: Shot, rig: Rig) -> Callable[[], object]:
    """A call that judges the break points of a shot; nothing if it shows no ring."""
    found = detect(shot, rig, edges=False).break_points
    if not isinstance(found, BreakPoints):
        return lambda: None
    return partial(without_outliers, found, rig, USUAL.about_shot(rig.stability, still=shot.still))


def _pose_record(shot: Shot | Detection, rig: Rig) -> str:
    """The line that `ringpose pose` writes for a shot."""
    return line_of(pose_record(Setup(rig=rig).measure(shot)))


def pose_figures(rounds: int) -> list[Figure]:
    """Each method of pose estimation."""
    image = stripe_image(Kind.DARK, 0)
    points = exact_break_points(image)
    calls: dict[str, Callable[[], object]] = {SOLVE_PNP: solve_pnp(points, image.rig.camera)}
    calls |= {
        method.value: partial(estimate_pose, points, image.rig, method)
        for method in Method
        if method.value in MAX_POSE_TIMES
    }
    calls[Method.ML.value] = _ml(points, image.rig)
    calls["judgement"] = _judgement(shot_of(image), image.rig)
    calls["track step"] = _track_step(points, image.rig)
    times_s = median_times_s(calls, rounds * POSES_PER_ROUND)
    reference_s = times_s.pop(SOLVE_PNP)
    return [
        Figure(name="solvePnP", measured=reference_s * 1e3, unit="ms"),
        *(
            Figure(name=name, measured=time_s / reference_s, unit=SOLVE_PNP, max_value=MAX_POSE_TIMES[name])
            for name, time_s in times_s.items()
        ),
    ]


def record_figures(rounds: int) -> list[Figure]:
    """A full pose record to its line: all that a line has with the usual assumptions."""
    image = stripe_image(Kind.DARK, 0)
    line = Setup(rig=image.rig).measure(shot_of(image))
    calls: dict[str, Callable[[], object]] = {"full": lambda: line_of(pose_record(line))}
    calls["brief"] = lambda: line_of(pose_record(line, brief=True))
    times_s = median_times_s(calls, rounds * POSES_PER_ROUND)
    return [Figure(name=name, measured=time_s * 1e3, unit="ms", max_value=0.1) for name, time_s in times_s.items()]


def _ml(points: BreakPoints, rig: Rig) -> Callable[[], object]:
    """A call of `ml` with the usual assumptions about a switched shot: motion, form of the ring, and rig stability."""
    timed = replace(points, stamp_s=0.1 * np.arange(len(points.flags)))
    return partial(estimate_pose, timed, rig, assumptions=USUAL.about_shot(rig.stability, still=False))


def _track_step(points: BreakPoints, rig: Rig) -> Callable[[], object]:
    """A call that adds one more pose to the track of a ring at rest, five a second."""
    tracker, stamps_s = Tracker(rig, TrackOptions()), count(step=0.2)
    line = pose_line(Detection(shot="a", stamp_s=0.0, break_points=points), rig)

    def step() -> object:
        stamp_s = next(stamps_s)
        return tracker.line_of(tracker.add(replace(line, stamp_s=stamp_s, pose_stamp_s=stamp_s)))

    return step


def rendering_figures(rounds: int, *, idle: bool) -> list[Figure]:
    """A frame of 1600 x 1200 with all lasers on, foil and sun; the reference is the sensor's noise and quantisation."""
    scene = read_scene(FULL_SCENE)
    view = replace(scene.views[0], light="strong")
    still = render_ring_view(scene, view, 0)
    electrons = still.electrons(0b111, scene.exposure_s)
    calls: dict[str, Callable[[], object]] = {
        "reference": lambda: digitised(electrons, scene.sensor, still.generator),
        "still view": lambda: still.frame(0b111, scene.exposure_s, 0.0),
    }
    with TemporaryDirectory() as folder:
        for model in ("ring-on-plate", "sinosat2"):
            moving = moving_scene(Path(folder), model)
            (first,) = ring_views(moving)
            calls[f"{model}, moving"] = partial(moving_frame, moving, first, 0b111, moving.exposure_s, 0.0, 0.0, (1,))
    small = replace(scene, rig=replace(scene.rig, camera=small_camera(scene.rig.camera)))
    illuminated = illuminated_ring(small, view)
    calls["preview, 640 x 480"] = partial(layers, illuminated, pixel_rays(small.rig.camera), samples=1)
    times_s = median_times_s(calls, rounds)
    limits = {"still view": 4.0, "ring-on-plate, moving": 12.0, "sinosat2, moving": 25.0}
    figures = [
        Figure(name=name, measured=times_s[name] / times_s["reference"], unit="x sensor noise", max_value=limit)
        for name, limit in limits.items()
    ]
    preview_s = times_s["preview, 640 x 480"]
    return [*figures, Figure(name="preview", measured=preview_s, unit="s", max_value=0.05, is_judged=idle)]


def moving_scene(folder: Path, model: str) -> Scene:
    """A model of the package that drifts and turns 0.5 m from the rig of the full scene, in sunlight."""
    values = yaml.safe_load(FULL_SCENE.read_text())
    for key in ("ring", "body", "boards"):
        del values[key]
    values |= {
        "rig": str(FULL_SCENE.with_name(values["rig"])),
        "exposure_s": 0.002,
        "stripe_dn": None,
        "target": {"model": model},
        "motion": {"angular_velocity_rad_s": [0.05, 0.05, 0.04], "velocity_m_s": [0.03, 0.03, -0.02]},
        "trajectory": [
            {"name": "a", "center_m": [-0.582, -0.02, 0.5], "pitch_rad": 0.05, "yaw_rad": 0.0, "light": "strong"}
        ],
    }
    path = folder / f"{model}.yaml"
    path.write_text(yaml.safe_dump({key: value for key, value in values.items() if value is not None}))
    return read_scene(path)


def small_camera(camera: Camera) -> Camera:
    """The same field of view in 640 x 480 pixels."""
    matrix = camera.camera_matrix * np.array([[0.4], [0.4], [1.0]])
    return replace(camera, image_width=640, image_height=480, camera_matrix=matrix)


def fidelity_figures() -> list[Figure]:
    """Stripes and edges of the adaptive samples against 256 samples in every pixel, on the small scene without foil."""
    scene = read_scene(SCENE)
    assert scene.body is not None
    scene = replace(scene, body=replace(scene.body, foil=None))
    view = next(view for view in ring_views(scene) if view.light == "normal")
    illuminated, rays = illuminated_ring(scene, view), pixel_rays(scene.rig.camera)
    quick, exact = layers(illuminated, rays), layers(illuminated, rays, samples=256)
    centroids = [
        np.abs(stripe_centroids(quick.laser[laser]) - stripe_centroids(exact.laser[laser]))
        for laser in range(len(scene.rig.lasers.names))
    ]
    shift = edge_shifts_px(quick.ambient, exact.ambient)
    return [
        Figure(name="edge shift, rms", measured=float(np.sqrt(np.mean(shift**2))), unit="px", max_value=0.005),
        Figure(
            name="stripe centroid bias", measured=float(max(map(np.nanmedian, centroids))), unit="px", max_value=0.001
        ),
    ]


def stripe_centroids(layer: Float32[Array, "row column"]) -> Float64[Array, "column"]:
    """Centroid of the light in each column; NaN without light."""
    light = layer.astype(float)
    total = light.sum(axis=0)
    centroid: Float64[Array, "column"] = (light * np.arange(len(light))[:, None]).sum(axis=0) / np.where(
        total > 0.01 * total.max(), total, np.nan
    )
    return centroid


ROWS = 12
"""Rows that are averaged, as the detector averages the image along an edge."""


def edge_shifts_px(quick: Float32[Array, "row column"], exact: Float32[Array, "row column"]) -> Float64[Array, "place"]:
    """Horizontal displacement of edges between flat sides, averaged along the edge over `ROWS` rows.

    In each row it is the difference of light in five pixels, over the step.
    """
    light = exact.astype(float)
    step = light[:, 4:] - light[:, :-4]
    flat = np.abs(np.diff(light, axis=1))
    beside = np.maximum(flat[:, :-3], flat[:, 3:])
    strong = (np.abs(step) > 0.05 * np.percentile(light, 99)) & (beside < 0.02 * np.abs(step))
    difference = np.apply_along_axis(np.convolve, 1, quick.astype(float) - exact, np.ones(5), mode="valid")
    row, column = np.nonzero(strong)
    in_row, number = np.unique(row * light.shape[1] + column // 32, return_inverse=True)  # windows of one edge
    of_row = np.bincount(number, difference[strong] / step[strong]) / np.bincount(number)
    place, number = np.unique(
        in_row // light.shape[1] // ROWS * light.shape[1] + in_row % light.shape[1], return_inverse=True
    )
    shifts: Float64[Array, "place"] = np.bincount(number, of_row) / ROWS
    return shifts[np.bincount(number) == ROWS]


def start_figures(calls: Mapping[str, Callable[[], object]], rounds: int, *, idle: bool) -> list[Figure]:
    """Wall times of processes until their first line; the first call is the reference."""
    times_s = median_times_s(calls, rounds, perf_counter)
    reference = next(iter(calls))
    return [
        Figure(
            name=name,
            measured=time_s / times_s[reference],
            unit=f"x {reference}",
            max_value=1.0 if "--help" in name else 2.0,
            is_judged=idle,
        )
        for name, time_s in times_s.items()
        if name != reference
    ]


def main() -> int:
    parser = options(__doc__, seeds=40)
    parser.add_argument("--chart", type=Path, help="draw where the time of a shot goes into this file")
    chosen = parser.parse_args()
    print(machine())
    is_kept = True
    for title, figures in sections(chosen.seeds, chosen.chart, idle=is_idle()):
        print(f"\n{title}")
        is_kept &= all(figure.is_kept for figure in printed(figures))
    return 0 if is_kept else 3


if __name__ == "__main__":
    sys.exit(main())
