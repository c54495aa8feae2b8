"""Live tracking from memory: preloaded frames at full speed, or at a camera's rate (`make bench-live`).

    PYTHONPATH=tests python -m benchmarks.live [--seconds N] [--rate HZ] [--check]

A thread hands frames over as a camera does: at `--rate`, default 60 a second, the newest shot is measured and those
before it are dropped. Prints for each light: poses per second and per time of EdgeDrawing on the same frame (measured
in this process before and after), the latency from the last frame of a shot to its written line, dropped shots,
processor time and memory. With `--check`, status 3 if a limit of the design is missed on an idle machine.
"""

import resource
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial
from time import perf_counter, process_time

import numpy as np
from benchmarks.frames import ALL, LIGHTS, Frames, rendered_frames
from benchmarks.limits import Figure, options, printed
from benchmarks.machine import is_idle, machine
from benchmarks.opencv_detectors import DetectorName, detector
from benchmarks.timing import one_core

from ringpose.capture.latest_frame import EarlyStripes, NewestShots, paced
from ringpose.capture.source import TrackedSequence, switched_steps
from ringpose.files.records import line_of
from ringpose.files.records.tracks import track_record
from ringpose.measure.stream import Setup, Stream, track_options
from ringpose.types.assumptions import USUAL
from ringpose.types.image import Shot
from ringpose.types.track import FusionStatus

MIN_POSES = {"dark": 1.0, "light": 0.7}
"""Poses in the time of one EdgeDrawing."""

WARM_UP = 10
"""Shots before the measurement begins."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Run:
    """What a run of live tracking has measured."""

    lines: int
    fused: int
    dropped: int
    wall_s: float
    cpu_s: float
    latency_s: np.ndarray
    reference_s: float
    """Processor time of EdgeDrawing on a frame with all lasers on."""


def frames_of_camera(frames: Frames, early: EarlyStripes, choose: TrackedSequence, rate_hz: float) -> Iterator[Shot]:
    """Shots whose lasers the track chooses, taken at a frame rate by this computer's clock."""
    lasers, number = len(frames.rig.lasers.names), 0
    ticks = paced(iter(int, 1), rate_hz)  # endless
    while True:
        masks = tuple(step.mask(lasers) for step in choose(switched_steps(lasers)))
        began_s = time.time()
        shot = frames.shot(number, masks, began_s)
        for frame in shot.frames:
            next(ticks)
            early.add(frame, shot.saturation_dn)
        number += 1
        yield shot


def tracked_live(light: str, seconds: float, rate_hz: float) -> Run:
    """Track the ring of preloaded frames for a time."""
    frames = rendered_frames(light)
    reference = partial(detector(DetectorName.EDGE_DRAWING), frames.of_mask[ALL[0]][0])
    references_s = [_cpu_s(reference) for _ in range(10)]
    early, choose = EarlyStripes(frames.rig), TrackedSequence()
    stream = Stream(Setup(rig=frames.rig), track_options(USUAL), early=early.stripes_of)
    latency_s, fused, dropped = list[float](), 0, 0
    began_s, began_cpu_s = perf_counter(), process_time()
    with NewestShots(frames_of_camera(frames, early, choose, rate_hz)) as newest:
        for number, live in enumerate(newest):
            measured = stream.measure(live.shot)
            choose.report(is_assigned=stream.assigns_lasers)
            assert measured.track is not None
            line_of(track_record(measured.track))
            if number == WARM_UP:
                began_s, began_cpu_s = perf_counter(), process_time()
            elif number > WARM_UP:
                latency_s.append(perf_counter() - live.taken_s)
                fused += measured.track.attempt.fusion_status is FusionStatus.FUSED
                dropped += live.dropped
                if perf_counter() - began_s > seconds:
                    break
        wall_s, cpu_s = perf_counter() - began_s, process_time() - began_cpu_s
    references_s += [_cpu_s(reference) for _ in range(10)]
    return Run(
        lines=len(latency_s),
        fused=fused,
        dropped=dropped,
        wall_s=wall_s,
        cpu_s=cpu_s,
        latency_s=np.array(latency_s),
        reference_s=float(np.median(references_s)),
    )


def live_figures(light: str, seconds: float, rate_hz: float, *, idle: bool) -> list[Figure]:
    """The figures of a run."""
    run = tracked_live(light, seconds, rate_hz)
    median_ms, p99_ms = (1e3 * float(each) for each in np.percentile(run.latency_s, [50, 99]))
    per_reference = run.lines * run.reference_s / run.wall_s
    figures = (
        Figure(
            name="poses in the time of EdgeDrawing",
            measured=per_reference,
            min_value=MIN_POSES[light],
            is_judged=idle,
        ),
        Figure(name="poses a second", measured=run.lines / run.wall_s, is_judged=idle),
        Figure(name="latency, median", measured=median_ms, unit="ms", is_judged=idle),
        Figure(name="latency, 99 %", measured=p99_ms, unit="ms", is_judged=idle),
        Figure(name="processor time a pose", measured=run.cpu_s / run.lines / run.reference_s, unit="x EdgeDrawing"),
        Figure(name="processors used", measured=run.cpu_s / run.wall_s),
        Figure(name="share of shots in the track", measured=run.fused / run.lines, min_value=0.99),
        Figure(name="dropped shots for each measured", measured=run.dropped / run.lines),
        Figure(
            name="memory at the peak",
            measured=resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024,
            unit="MB",
        ),
    )
    return [each.under(light) for each in figures]


def _cpu_s(call: partial[object]) -> float:
    start_s = process_time()
    call()
    return process_time() - start_s


def main() -> int:
    parser = options(__doc__, seconds=20, rate=60)
    parser.add_argument("--check", action="store_true", help="status 3 if a limit is missed")
    chosen = parser.parse_args()
    print(machine())
    idle, is_kept = is_idle(), True
    with one_core():
        for light in LIGHTS:
            print(f"\nlive tracking from memory, {light}: {chosen.seconds} s at {chosen.rate} frames a second")
            is_kept &= all(
                each.is_kept for each in printed(live_figures(light, chosen.seconds, chosen.rate, idle=idle))
            )
    return 0 if is_kept or not chosen.check else 3


if __name__ == "__main__":
    sys.exit(main())
