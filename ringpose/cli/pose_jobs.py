"""Measurement of shots: each by itself, one after the other as a stream, or by several processes (`pose --jobs`)."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from time import perf_counter
from typing import TYPE_CHECKING

from ringpose.types.options import Method, PoseFrame

if TYPE_CHECKING:
    from ringpose.capture.source import TrackedSequence
    from ringpose.cli.batch import Batch
    from ringpose.cli.overlays import PosePictures
    from ringpose.detect.difference_images import LaserImage
    from ringpose.files.inputs import Input
    from ringpose.geometry.camera_motion import CameraMotion
    from ringpose.track.pipeline import Tracker
    from ringpose.types.assumptions import AssumptionOptions
    from ringpose.types.detection import Detection, Stripes
    from ringpose.types.image import Shot
    from ringpose.types.pose import KnownRadii, PoseLine, Ring
    from ringpose.types.rig import Rig


@dataclass(frozen=True, slots=True, eq=False)
class SingleShot:
    """Measures each input independently of the others, with the given rig; worker processes import this class."""

    rig: "Rig"
    channel: str | None
    method: Method
    frame: PoseFrame
    known: "KnownRadii | Sequence[Ring] | None"
    options: "AssumptionOptions"
    camera: "CameraMotion | None" = None

    def __call__(self, item: "Input") -> "tuple[Input, PoseLine]":
        """The input with its pose line."""
        return item, self.line(self.read(item))

    def read(self, item: "Input") -> "Shot | Detection":
        """The shot or detection in an input, by its contents; rejected if it does not match the rig."""
        from ringpose.files.images.shots import read_shot, shot_of
        from ringpose.files.inputs import Record
        from ringpose.files.npz import Archive
        from ringpose.files.records.detections import checked_detection, detection_in, detection_of

        if isinstance(item, Record):
            return checked_detection(detection_of(item.values, item.location), self.rig, item.location)
        if item.suffix.lower() != ".npz":
            return read_shot(item, self.channel, self.rig)
        archive = Archive(item)
        if "schema" in archive:  # a shot has none
            return checked_detection(detection_in(archive), self.rig, str(item))
        return shot_of(archive, self.rig)

    def line(self, source: "Shot | Detection") -> "PoseLine":
        """The pose line of a shot or detection."""
        from ringpose.pose.pipeline import pose_line

        return pose_line(source, self.rig, self.method, self.frame, self.known, self.options, self.camera)


class PoseStream:
    """Measures shots one after the other: monitors the rig, and with a `tracker` uses the track in the next shot."""

    def __init__(self, single: SingleShot, tracker: "Tracker | None") -> None:
        from ringpose.pose.drift import DriftMonitor
        from ringpose.pose.form_monitor import FormMonitor

        tolerance_m = getattr(single.known, "tolerance_m", None)  # of a ring of the catalogue
        if tolerance_m is not None:
            single = replace(single, options=replace(single.options, ring_tolerance_m=tolerance_m))
        self._single, self._tracker = single, tracker
        self.monitor = DriftMonitor(single.rig, single.rig.stability.scaled(single.options.rig_stability))
        self.form = FormMonitor()
        self.pictures: PosePictures | None = None
        self.sequence: TrackedSequence | None = None
        self.shots = None
        self.searched: Callable[[LaserImage], Stripes | None] | None = None
        """The stripes of a frame that were found before its shot was complete."""
        self.motion_until: Callable[[float], CameraMotion] | None = None
        """The motion of the camera up to a stamp, for robot poses that arrive meanwhile."""
        if tracker is not None:
            from ringpose.capture import source
            from ringpose.track.shots import ShotTracker

            self.sequence, self.shots = source.TrackedSequence(), ShotTracker(tracker)

    @property
    def rig(self) -> "Rig":
        """The rig, with the light planes that the stream has shown to have moved."""
        return self.monitor.rig

    def measured(self, source: "Shot | Detection") -> "PoseLine":
        """The pose line of a shot or detection."""
        from ringpose.types.image import Shot

        single = replace(self._single, rig=self.rig)
        if not isinstance(source, Shot):
            return self._line(single, source, source)
        if self.motion_until is not None:
            single = replace(single, camera=self.motion_until(source.mid_exposure_s(-1)))
            if self._tracker is not None:
                self._tracker.camera = single.camera
        start_s = perf_counter()
        detection = self._detected(source, single)
        detect_s = perf_counter() - start_s
        line = self._line(single, source, detection)
        return replace(line, latency_s=line.latency_s + detect_s, stage_s={"detect": detect_s, **line.stage_s})

    def _detected(self, shot: "Shot", single: SingleShot) -> "Detection":
        from ringpose.detect.pipeline import detect

        assumptions = single.options.about_shot(single.rig.stability, still=shot.still)
        if self.shots is not None:
            return self.shots.detected(shot, single.rig, assumptions, self.searched)
        return detect(shot, single.rig, assumptions=assumptions, camera=single.camera, searched=self.searched)

    def _line(self, single: SingleShot, source: "Shot | Detection", detection: "Detection") -> "PoseLine":
        if self.pictures is not None:
            self.pictures.keep(source, detection)
        return single.line(detection)


def recorded_lines(
    inputs: Sequence[str],
    single: SingleShot,
    jobs: int,
    batch: "Batch",
    rig_now: "Callable[[], Rig]",
    measure: "Callable[[Shot | Detection], PoseLine]",
) -> "Iterator[PoseLine]":
    """Pose lines in the order of the inputs, the same for any number of processes; the batch reports bad inputs.

    With several processes, each measures shots by themselves. Once the stream shows that a light plane has moved, the
    following shots are measured again with the corrected rig by `measure`, as with one process.
    """
    from ringpose.files.images.shots import SHOT_SUFFIXES
    from ringpose.files.inputs import RECORDS_SUFFIX
    from ringpose.files.inputs import inputs as named

    items = named(inputs, (RECORDS_SUFFIX, *SHOT_SUFFIXES))
    if jobs == 1:
        for item in batch.valid_inputs(items):
            with batch.guarded():
                yield measure(single.read(item))
        return
    for item, line in batch.results(single, items, jobs):
        if rig_now() is single.rig:
            yield line
        else:
            with batch.guarded():
                yield measure(single.read(item))
