"""Poses of recorded shots, by one process or several (`ringpose pose --jobs`)."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from ringpose.types.options import Method, PoseFrame

if TYPE_CHECKING:
    from ringpose.cli.batch import Batch
    from ringpose.files.inputs import Input
    from ringpose.geometry.camera_motion import CameraMotion
    from ringpose.types.assumptions import AssumptionOptions
    from ringpose.types.detection import Detection
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
        """The shot or detection in an input, which must fit the rig."""
        from ringpose.files.sources import read_source

        return read_source(item, self.rig, self.channel)

    def line(self, source: "Shot | Detection") -> "PoseLine":
        """The pose line of a shot or detection."""
        from ringpose.pose.pipeline import pose_line

        return pose_line(source, self.rig, self.method, self.frame, self.known, self.options, self.camera)


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
    from ringpose.files.inputs import inputs as named
    from ringpose.files.sources import SUFFIXES

    items = named(inputs, SUFFIXES)
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
