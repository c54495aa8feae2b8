"""`ringpose pose`: detections, shots or images -> one pose line each."""

from collections.abc import Sequence
from time import perf_counter
from typing import TYPE_CHECKING, Annotated

import typer

from ringpose.cli.app import app
from ringpose.cli.known_ring import RadiusInner, RadiusOuter, RadiusSd, RingName, RingsFile, SaidOfRing
from ringpose.cli.options import ImageChannel, Inputs, PoseFrame, PoseMethod, Quiet, RigFile, Verbose
from ringpose.errors import UsageError
from ringpose.pose.method import Method

if TYPE_CHECKING:
    from ringpose.types.break_points import Detection
    from ringpose.types.frame import Shot
    from ringpose.types.pose_line import PoseLine
    from ringpose.types.rig import Rig
    from ringpose.types.ring import KnownRadii, Ring

Frame = Annotated[PoseFrame, typer.Option("--frame", help="Frame of the vectors; tool needs the rig's mount.")]


@app.command()
def pose(
    inputs: Inputs,
    rig: RigFile,
    method: PoseMethod = Method.ML,
    frame: Frame = PoseFrame.CAMERA,
    radius_outer: RadiusOuter = None,
    radius_inner: RadiusInner = None,
    radius_sd: RadiusSd = None,
    ring: RingName = None,
    rings: RingsFile = None,
    channel: ImageChannel = None,
    verbose: Verbose = False,
    quiet: Quiet = False,
) -> None:
    """Compute the pose of the ring: one JSON record a shot on stdout."""
    from ringpose.cli import messages
    from ringpose.cli.batch import Batch
    from ringpose.cli.known_ring import known_ring
    from ringpose.cli.progress import counted
    from ringpose.cli.rig_watch import RigWatch, remarks_on
    from ringpose.errors import NO_POSE
    from ringpose.files import records
    from ringpose.files.inputs import inputs as named
    from ringpose.files.poses import pose_record
    from ringpose.files.rigs import read_rig, require_mount
    from ringpose.files.sources import SUFFIXES, read_source

    said = SaidOfRing(
        radius_outer_m=radius_outer, radius_inner_m=radius_inner, radius_sd_m=radius_sd, ring=ring, rings=rings
    )
    if method is not Method.ML and not said.nothing:
        raise UsageError("--method", f"{method.value} has no use for what is known of the ring", "use --method ml")
    known = known_ring(said)
    rig_of_shots = read_rig(rig)
    if frame is PoseFrame.TOOL:
        require_mount(rig_of_shots, rig)
    batch, watch = Batch(), RigWatch(rig_of_shots.lasers.names)
    for item in counted(batch.good(named(inputs, SUFFIXES)), "shots", quiet):
        with batch.item():
            line = watch.watched(
                pose_line(read_source(item, rig_of_shots, channel), rig_of_shots, method, frame, known)
            )
            records.write(pose_record(line))
            if verbose:
                messages.say(f"{line.shot}: {remarks_on(line)}")
            if line.pose is None:
                batch.met(NO_POSE)
    batch.finish()


def pose_line(
    source: "Shot | Detection",
    rig: "Rig",
    method: Method,
    frame: PoseFrame,
    known: "KnownRadii | Sequence[Ring] | None" = None,
) -> "PoseLine":
    """The pose of one shot, or the reason why it has none, and how long that took."""
    from ringpose.pose.other_frame import pose_in_frame
    from ringpose.pose.pipeline import estimate_pose
    from ringpose.types.break_points import BreakPoints, Detection, NoBreakPoints
    from ringpose.types.pose_line import PoseLine
    from ringpose.types.ring_pose import NoPose, RingPose

    start_s = perf_counter()
    detection = source if isinstance(source, Detection) else _detected(source, rig)
    points = detection.break_points
    result: RingPose | NoPose | NoBreakPoints = (
        estimate_pose(points, rig, method, detection.ring_edges, known) if isinstance(points, BreakPoints) else points
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


def _detected(shot: "Shot", rig: "Rig") -> "Detection":
    """What is found in a shot; a pose from a record needs no detector."""
    from ringpose.detect.pipeline import detect

    return detect(shot, rig)
