"""Poses of recorded shots by several processes (`ringpose pose --jobs`)."""

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
    """Measures an input by itself, with the rig as it was given; worker processes import it."""

    rig: "Rig"
    channel: str | None
    method: Method
    frame: PoseFrame
    known: "KnownRadii | Sequence[Ring] | None"
    options: "AssumptionOptions"
    camera: "CameraMotion | None" = None

    def __call__(self, item: "Input") -> "tuple[Input, PoseLine]":
        """The input with its pose line."""
        from ringpose.files.sources import read_source
        from ringpose.pose.pipeline import pose_line

        source = read_source(item, self.rig, self.channel)
        line = pose_line(
            source,
            self.rig,
            method=self.method,
            frame=self.frame,
            known=self.known,
            options=self.options,
            camera=self.camera,
        )
        return item, line


def parallel_lines(
    inputs: Sequence[str],
    work: SingleShot,
    jobs: int,
    batch: "Batch",
    rig_now: "Callable[[], Rig]",
    measure: "Callable[[Shot | Detection], PoseLine]",
) -> "Iterator[PoseLine]":
    """Pose lines in the order of the inputs, as one process gives them; bad inputs are reported by the batch.

    A shot that follows the discovery of a moved light plane is measured again, by this process and with `rig_now`.
    """
    from ringpose.files.inputs import inputs as named
    from ringpose.files.sources import SUFFIXES, read_source

    for item, line in batch.results(work, named(inputs, SUFFIXES), jobs):
        if rig_now() is work.rig:
            yield line
        else:
            with batch.guarded():
                yield measure(read_source(item, work.rig, work.channel))
