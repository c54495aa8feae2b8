"""Every limit of the design on speed and accuracy, measured on this machine (`make bench-speed`).

    PYTHONPATH=tests python -m benchmarks.speed [--seeds N] [--rounds N] [--json FILE]    status 1 if a limit is missed

Times are ratios to a reference that runs alternately on the same core, so that they hardly depend on the machine.
"""

import argparse
import json
import sys
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from time import perf_counter, process_time

import numpy as np
from benchmarks.accuracy import accuracy_figures, pose_accuracy
from benchmarks.limits import Figure, Section, section_record, section_text
from benchmarks.opencv_detectors import DetectorName, detector
from benchmarks.stripe_images import (
    Kind,
    exact_break_points,
    moved,
    shot_of,
    stripe_image,
    switched_frames,
    switched_shot,
)

from ringpose.bench.speed import POSES_PER_ROUND, median_times_s, one_core, solve_pnp
from ringpose.cli.bench.speed import start_calls
from ringpose.cli.options import PoseFrame
from ringpose.detect.pipeline import detect
from ringpose.detect.stripes import find_stripes
from ringpose.files.poses import pose_record
from ringpose.files.records import line_of
from ringpose.files.scenes import read_scene
from ringpose.pose.pipeline import estimate_pose
from ringpose.pose.record import pose_line
from ringpose.simulate.pipeline import render_ring_view
from ringpose.simulate.placement import ring_views
from ringpose.simulate.sensor import digitised
from ringpose.types.image import Shot
from ringpose.types.options import Method
from ringpose.types.rig import Rig

SCENE = Path(__file__).parents[2] / "examples" / "scene.yaml"
EDGE_DRAWING, SOLVE_PNP = "x EdgeDrawing", "x solvePnP"

TIMED_IMAGES = 3
"""Images of each kind that are timed; they differ little."""

MAX_POSE_TIMES = {"paper": 10.0, "paper-constrained": 10.0, "ml": 50.0}

LATENCY_SAMPLES = 100


def sections(seeds: int, rounds: int) -> Iterator[Section]:
    """The sections, each as soon as it is measured."""
    with one_core():
        yield Section(title="segments of the paper's detector, full frame", figures=segment_figures(rounds))
        yield Section(title="image to break points and pose record", figures=chain_figures(rounds))
        yield Section(title="break points to pose", figures=pose_figures(rounds))
        yield Section(title="last frame read to record written", figures=latency_figures(rounds))
        yield Section(title="rendered frame", figures=rendering_figures(rounds))
    with TemporaryDirectory() as folder:
        image = stripe_image(Kind.DARK, 0)
        calls = start_calls(Path(folder), shot_of(image), image.rig)
        yield Section(title="start", figures=start_figures(calls, rounds))
    centers, ends = accuracy_figures(seeds)
    yield Section(title=f"stripe centres, {seeds} images of each kind", figures=centers)
    yield Section(title=f"break points, {seeds} images of each kind", figures=ends)
    yield Section(title="pose", figures=pose_accuracy(samples=10 * seeds))


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
    """From the image to break points with covariance, and on to the pose record."""
    times_s: dict[str, float] = {}
    for seed in range(TIMED_IMAGES):
        for name, time_s in median_times_s(_chain_calls(seed), rounds).items():
            times_s[name] = times_s.get(name, 0.0) + time_s
    further_s = (times_s["four"] - times_s["one"]) / 3

    def figure(name: str, time_s: float, limit: float = np.inf) -> Figure:
        return Figure(name=name, measured=time_s / times_s["reference"], unit=EDGE_DRAWING, max_value=limit)

    stream = times_s["stream"] / times_s["edges"]
    return [
        figure("one frame, all lasers on, full frame", times_s["one"], 0.12),
        figure("of that, stripe centres", times_s["centers"]),
        figure("one frame, all lasers on, tracked bands", times_s["bands"], 0.08),
        figure("each further frame of a switched shot", further_s, 0.12),
        figure("with the ring's edges, full frame", times_s["edges"]),
        Figure(name="pose stream", measured=stream, unit="x detect alone", max_value=2.0),
    ]


def _chain_calls(seed: int) -> dict[str, Callable[[], object]]:
    image, frames = switched_frames(Kind.DARK, seed)
    shot, rig = shot_of(image), image.rig
    return {
        "reference": partial(detector(DetectorName.EDGE_DRAWING), image.image),
        "centers": partial(find_stripes, image.image),
        "one": partial(detect, shot, rig, edges=False),
        "bands": partial(detect, shot, rig, edges=False, predicted=moved(exact_break_points(image))),
        "four": partial(detect, switched_shot(frames[1:]), rig, edges=False),
        "edges": partial(detect, shot, rig),
        "stream": partial(_pose_record, shot, rig),
    }


def _pose_record(shot: Shot, rig: Rig) -> str:
    """The line that `ringpose pose` writes for a shot."""
    return line_of(pose_record(pose_line(shot, rig, Method.ML, PoseFrame.CAMERA)))


def pose_figures(rounds: int) -> list[Figure]:
    """Each method of pose estimation."""
    image = stripe_image(Kind.DARK, 0)
    points = exact_break_points(image)
    calls: dict[str, Callable[[], object]] = {SOLVE_PNP: solve_pnp(points, image.rig.camera)}
    calls |= {method.value: partial(estimate_pose, points, image.rig, method) for method in Method}
    times_s = median_times_s(calls, rounds * POSES_PER_ROUND)
    reference_s = times_s.pop(SOLVE_PNP)
    return [
        Figure(name="solvePnP", measured=reference_s * 1e3, unit="ms"),
        *(
            Figure(name=name, measured=time_s / reference_s, unit=SOLVE_PNP, max_value=MAX_POSE_TIMES[name])
            for name, time_s in times_s.items()
        ),
        Figure(name="track step", measured=None, unit=SOLVE_PNP, max_value=15.0),
    ]


def latency_figures(rounds: int) -> list[Figure]:
    """A switched shot in memory to its record, without camera; the reference is one edge search and one `ml`.

    The distribution is that of repeated calls with one shot.
    """
    image, frames = switched_frames(Kind.DARK, 0)
    points, rig = exact_break_points(image), image.rig
    calls: dict[str, Callable[[], object]] = {
        "edges": partial(detect, shot_of(image), rig),
        "no edges": partial(detect, shot_of(image), rig, edges=False),
        "ml": partial(estimate_pose, points, rig),
    }
    times_s = median_times_s(calls, rounds)
    reference_s = times_s["edges"] - times_s["no edges"] + times_s["ml"]
    shot, samples_s = switched_shot(frames[1:]), []
    for _ in range(LATENCY_SAMPLES):
        start_s = process_time()
        _pose_record(shot, rig)
        samples_s.append(process_time() - start_s)
    median_s, p99_s = np.percentile(samples_s, [50, 99])
    return [
        Figure(name="median", measured=median_s / reference_s, unit="x (edge search + ml)", max_value=1.5),
        Figure(name="99th percentile", measured=p99_s / median_s, unit="x median", max_value=3.0),
    ]


def rendering_figures(rounds: int) -> list[Figure]:
    """A frame of a still view with all lasers on; the reference is the noise and quantisation of the sensor."""
    scene = read_scene(SCENE)
    view = render_ring_view(scene, ring_views(scene)[-1], 0)
    exposure_s = scene.exposure_s
    electrons = view.electrons(0b111, exposure_s)
    calls: dict[str, Callable[[], object]] = {
        "reference": lambda: digitised(electrons, scene.sensor, view.generator),
        "frame": lambda: view.frame(0b111, exposure_s, 0.0),
    }
    times_s = median_times_s(calls, rounds)
    unit = "x sensor noise"
    return [
        Figure(name="still view", measured=times_s["frame"] / times_s["reference"], unit=unit, max_value=4.0),
        Figure(name="ring-on-plate, moving", measured=None, unit=unit, max_value=10.0),
        Figure(name="sinosat2, moving", measured=None, unit=unit, max_value=25.0),
    ]


def start_figures(calls: dict[str, Callable[[], object]], rounds: int) -> list[Figure]:
    """Wall times of processes until their first line; the first call is the reference."""
    times_s = median_times_s(calls, rounds, perf_counter)
    reference = next(iter(calls))
    return [
        Figure(
            name=name,
            measured=time_s / times_s[reference],
            unit=f"x {reference}",
            max_value=1.3 if "--help" in name else 2.0,
        )
        for name, time_s in times_s.items()
        if name != reference
    ]


def main(arguments: Sequence[str] | None = None) -> int:
    """Print all sections; 1 if a limit is missed."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=40, help="synthetic images of each kind for the accuracy")
    parser.add_argument("--rounds", type=int, default=11, help="repetitions of each time")
    parser.add_argument("--json", type=Path, help="write the figures into this file too")
    options = parser.parse_args(arguments)
    measured = []
    for section in sections(options.seeds, options.rounds):
        print(section_text(section), flush=True)
        measured.append(section)
    if options.json:
        options.json.write_text(json.dumps([section_record(section) for section in measured]) + "\n")
    missed = sum(section.missed for section in measured)
    print(f"limits missed: {missed}")
    return 1 if missed else 0


if __name__ == "__main__":
    sys.exit(main())
