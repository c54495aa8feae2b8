"""Where the processor time of a shot goes: samples of the running functions by stage, and their chart."""

import signal
from collections import Counter
from collections.abc import Callable, Mapping
from inspect import unwrap
from pathlib import Path
from time import process_time
from types import CodeType, FrameType

from ringpose.detect.break_points import without_outliers
from ringpose.detect.pipeline import detect, ring_in_whole_frames, ring_near_prediction, visible_edges
from ringpose.detect.stripes import find_stripes
from ringpose.files.records import line_of
from ringpose.files.records.poses import pose_record
from ringpose.files.records.tracks import track_record
from ringpose.measure.stream import pose_result
from ringpose.measure.warm_start import WarmStart
from ringpose.pose.protection import protection_of
from ringpose.pose.rig_monitor import DriftMonitor, FormMonitor

STAGES: Mapping[str, tuple[Callable[..., object], ...]] = {
    "prediction": (WarmStart.before,),
    "stripes": (find_stripes,),
    "face and ends": (ring_in_whole_frames, ring_near_prediction),
    "judgement": (without_outliers,),
    "ring edges": (visible_edges,),
    "rest of detection": (detect,),
    "estimate": (pose_result,),
    "protection levels": (protection_of,),
    "drift and form": (DriftMonitor.update, FormMonitor.update),
    "track": (WarmStart.added,),
    "record": (pose_record, track_record, line_of),
}
"""The functions of each stage, without those that they call and that are of another stage."""

REST = "rest"

SAMPLE_S = 1e-3


def stage_times_s(call: Callable[[], object], calls: int) -> dict[str, float]:
    """Processor seconds of one call by stage: the shares of the samples, times the mean time.

    Samples are taken after each millisecond of processor time, between two instructions of Python: the time of a
    kernel is that of the stage that has called it.
    """
    stage_of = {unwrap(function).__code__: name for name, functions in STAGES.items() for function in functions}
    samples: Counter[str] = Counter()

    def sample(_signal: int, frame: FrameType | None) -> None:
        samples[_stage(stage_of, frame)] += 1

    before = signal.signal(signal.SIGPROF, sample)
    start_s = process_time()
    signal.setitimer(signal.ITIMER_PROF, SAMPLE_S, SAMPLE_S)
    try:
        for _ in range(calls):
            call()
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0.0)
        signal.signal(signal.SIGPROF, before)
    mean_s, total = (process_time() - start_s) / calls, max(samples.total(), 1)
    return {name: mean_s * samples[name] / total for name in (*STAGES, REST)}


def _stage(stage_of: Mapping[CodeType, str], frame: FrameType | None) -> str:
    """The stage of the innermost function that has one."""
    while frame is not None:
        if frame.f_code in stage_of:
            return stage_of[frame.f_code]
        frame = frame.f_back
    return REST


def draw_stages(bars: Mapping[str, Mapping[str, float]], path: Path) -> None:
    """One stacked bar for each kind of shot, in times of EdgeDrawing."""
    from matplotlib import colormaps
    from matplotlib.figure import Figure as Chart

    chart = Chart(figsize=(9.0, 1.4 + 0.6 * len(bars)), layout="constrained")
    axes = chart.subplots()
    left = dict.fromkeys(bars, 0.0)
    for number, stage in enumerate((*STAGES, REST)):
        widths = [times[stage] for times in bars.values()]
        axes.barh([*bars], widths, left=[*left.values()], color=colormaps["tab20"](number), label=stage)
        left = {name: left[name] + width for name, width in zip(bars, widths, strict=True)}
    axes.invert_yaxis()
    axes.set_xlabel("processor time of a shot, in times of EdgeDrawing on its frame")
    chart.legend(loc="outside lower center", ncols=4, frameon=False)
    path.parent.mkdir(parents=True, exist_ok=True)
    chart.savefig(path, dpi=120)
