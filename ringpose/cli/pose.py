"""`ringpose pose`: detections, shots or images -> one pose line each."""

from time import perf_counter
from typing import TYPE_CHECKING, Annotated

import typer

from ringpose.cli.app import app
from ringpose.cli.detect import detection_of
from ringpose.cli.options import ImageChannel, Inputs, PoseFrame, PoseMethod, Quiet, RigFile, Verbose
from ringpose.pose.method import Method

if TYPE_CHECKING:
    from ringpose.types.break_points import Detection
    from ringpose.types.frame import Shot
    from ringpose.types.pose_line import PoseLine
    from ringpose.types.rig import Rig

Frame = Annotated[PoseFrame, typer.Option("--frame", help="Frame of the vectors; tool needs the rig's mount.")]


@app.command()
def pose(
    inputs: Inputs,
    rig: RigFile,
    method: PoseMethod = Method.ML,
    frame: Frame = PoseFrame.CAMERA,
    channel: ImageChannel = None,
    verbose: Verbose = False,
    quiet: Quiet = False,
) -> None:
    """Compute the pose of the ring: one JSON record a shot on stdout."""
    from ringpose.cli import messages
    from ringpose.cli.batch import Batch
    from ringpose.cli.progress import counted
    from ringpose.errors import NO_POSE
    from ringpose.files import records
    from ringpose.files.inputs import inputs as named
    from ringpose.files.poses import pose_record
    from ringpose.files.rigs import read_rig, require_mount
    from ringpose.files.sources import SUFFIXES, read_source

    rig_of_shots = read_rig(rig)
    if frame is PoseFrame.TOOL:
        require_mount(rig_of_shots, rig)
    batch = Batch()
    for item in counted(batch.good(named(inputs, SUFFIXES)), "shots", quiet):
        with batch.item():
            line = pose_line(read_source(item, rig_of_shots, channel), rig_of_shots, method, frame)
            records.write(pose_record(line))
            if verbose:
                messages.say(f"{line.shot}: {line.reason or ', '.join(line.flags) or line.status}")
            if line.pose is None:
                batch.met(NO_POSE)
    batch.finish()


def pose_line(source: "Shot | Detection", rig: "Rig", method: Method, frame: PoseFrame) -> "PoseLine":
    """The pose of one shot, or the reason why it has none, and how long that took."""
    from ringpose.pose.other_frame import pose_in_frame
    from ringpose.pose.pipeline import estimate_pose
    from ringpose.types.break_points import BreakPoints, Detection, NoBreakPoints
    from ringpose.types.pose_line import PoseLine
    from ringpose.types.ring_pose import NoPose, RingPose

    start_s = perf_counter()
    detection = source if isinstance(source, Detection) else detection_of(source, rig)
    points = detection.break_points
    result: RingPose | NoPose | NoBreakPoints = (
        estimate_pose(points, rig, method, detection.ring_edges) if isinstance(points, BreakPoints) else points
    )
    if isinstance(result, RingPose) and frame is PoseFrame.TOOL and rig.tool_from_camera is not None:
        result = pose_in_frame(result, rig.tool_from_camera)
    return PoseLine(
        shot=detection.shot,
        stamp_s=detection.stamp_s,
        pose=result if isinstance(result, RingPose) else None,
        reason=(result.remark or None) if isinstance(result, RingPose) else result.value,
        frame=frame.value,
        latency_s=perf_counter() - start_s,
        rig=rig.sha256,
    )
