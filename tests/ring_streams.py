"""Streams of shots of a ring at many poses, and a rig one of whose light planes has moved."""

from dataclasses import replace

from ring_scenes import face_points_of, make_scene, moved_rig

from ringpose.measure.stream import pose_result
from ringpose.pose.rig_monitor import DriftMonitor
from ringpose.types.assumptions import TYPICAL_STABILITY, Assumptions
from ringpose.types.pose import NoPose, PoseLine
from ringpose.types.rig import PLANE_PARAMETERS

ASSUMED = Assumptions(ring_tolerance_m=1e-4, stability=TYPICAL_STABILITY)


def moved(rig, laser, tilt_rad=(0.0, 0.0), shift_m=0.0):
    """The rig with one light plane moved."""
    names = [f"{rig.lasers.names[laser]}.{each}" for each in PLANE_PARAMETERS]
    return moved_rig(rig, names, (*tilt_rad, shift_m))


def within_stability(rig, rng):
    """A rig that has changed since its calibration as its stability states."""
    tilt_sd_rad, distance_sd_m = rig.stability.plane_tilt_rad, rig.stability.plane_distance_m
    for laser in range(len(rig.lasers.normal)):
        rig = moved(rig, laser, tilt_sd_rad * rng.normal(size=2), distance_sd_m * rng.normal())
    return rig


def poses_before(rig, rng, shots):
    """Scenes at many poses, seen by a rig, and their noisy break points."""
    for _ in range(shots):
        tilt, distance_m, turn = rng.uniform(-0.2, 0.2, 2), rng.uniform(0.3, 1.0), rng.uniform(-0.2, 0.2)
        scene = make_scene(rig, distance_m=float(distance_m), tilt_rad=tuple(tilt), turn_rad=float(turn))
        yield scene, face_points_of(scene, 0.3, 0.02, rng)


def measured_stream(rig, scenes, until=None, assumed=ASSUMED):
    """The lines of a stream of scenes, break points and perhaps edges, and the warnings by shot.

    It ends early at a warning that contains the text `until`.
    """
    monitor, lines, warnings = DriftMonitor(rig, rig.stability), [], {}
    for number, (_, points, *edges) in enumerate(scenes):
        assumptions = replace(assumed, stability=monitor.rig.stability)
        result = pose_result(points, monitor.rig, ring_edges=edges[0] if edges else None, assumptions=assumptions)
        pose = None if isinstance(result.pose, NoPose) else result.pose
        line = PoseLine(
            shot=str(number),
            stamp_s=float(number),
            pose=pose,
            flags=result.flags,
            priors=result.priors,
            measurement=result.measurement,
            plane_evidence=result.plane_evidence,
            rig=rig.sha256,
        )
        line, warning = monitor.update(line)
        lines.append(line)
        if warning is not None:
            warnings[number] = warning
            if until is not None and until in warning:
                break
    return lines, warnings
