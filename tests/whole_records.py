"""Records in which everything is known, and one of the version before."""

import math
from dataclasses import replace
from typing import Any

import numpy as np

from ringpose.files import records
from ringpose.types.assumptions import Assumptions, MotionPrior, RigStability
from ringpose.types.detection import BreakPoints, Detection, JudgedRing, Rejection, RingEdgePoints, Segments, Stripes
from ringpose.types.pose import (
    LaserState,
    LinearizationPoint,
    PlaneEvidence,
    PoseFlag,
    PoseLine,
    Priors,
    RadiusPrior,
    RingMeasurement,
    RingPose,
    RingVelocity,
)
from ringpose.types.protection import Protection
from ringpose.types.rig import LaserBow, PlaneCorrection
from ringpose.types.track import (
    Attempt,
    FusionStatus,
    GraspState,
    MotionModel,
    NextTick,
    ProcessNoise,
    SideHypothesis,
    TrackLine,
    Validity,
)
from ringpose.types.truth import Truth, TruthFrame


def record_of(values: dict[str, Any]) -> dict[str, Any]:
    """The record as it is read from its line."""
    return records.parsed_record(records.line_of(values), "x")


def square(rng: np.random.Generator, size: int) -> Any:
    """A covariance, symmetric to the last bit."""
    root = rng.normal(size=(size, size))
    product = root @ root.T
    return (product + product.T) / 2


def complete_pose(rng: np.random.Generator) -> RingPose:
    """A degraded pose of which everything is known."""
    normal = rng.normal(size=3)
    return RingPose(
        center_m=rng.normal(size=3),
        normal=normal / np.linalg.norm(normal),
        radius_inner_m=0.567,
        radius_outer_m=0.597,
        grasp_m=rng.normal(size=3),
        method="paper",
        condition_number=30.0,
        residual_rms_px=0.1,
        covariance=square(rng, 7),
        covariance_center_m2=square(rng, 3),
        covariance_grasp_m2=square(rng, 3),
        flags=PoseFlag.CENTER_WEAK | PoseFlag.POINT_REJECTED,
    )


def protection() -> Protection:
    """Levels of all but the centre."""
    return Protection(
        risk=1e-5,
        uncovered=1e-6,
        grasp_normal_m=0.002,
        grasp_radial_m=0.001,
        normal_rad=0.03,
        center_m=np.full(3, math.inf),
        sd_factor=1.2,
    )


def measurement_with(names, square_root, **changes) -> RingMeasurement:
    """A measurement of a ring at 0.5 m, with these nuisance parameters and rows."""
    point = LinearizationPoint(
        center_m=np.array([0.0, 0.0, 0.5]),
        normal=np.array([0.0, 0.0, -1.0]),
        radius_inner_m=0.5,
        radius_outer_m=0.6,
        velocity_m_s=np.zeros(3),
        rate_rad_s=np.zeros(3),
    )
    stated = {"degrees_of_freedom": 1, "chi2": 0.0} | changes
    return RingMeasurement(linearized_at=point, nuisance_parameters=names, square_root=square_root, **stated)


def complete_measurement(rng: np.random.Generator) -> RingMeasurement:
    """A measurement with two nuisance parameters."""
    return RingMeasurement(
        linearized_at=LinearizationPoint(
            center_m=rng.normal(size=3),
            normal=np.array([0.0, 0.6, -0.8]),
            radius_inner_m=0.567,
            radius_outer_m=math.nan,
            velocity_m_s=rng.normal(size=3),
            rate_rad_s=rng.normal(size=3),
        ),
        nuisance_parameters=("left.tilt_1", "fx"),
        square_root=np.triu(rng.normal(size=(9, 15))),
        degrees_of_freedom=2,
        chi2=1.5,
    )


def complete_line(rng: np.random.Generator) -> PoseLine:
    """A line in which everything is known."""
    return line(
        complete_pose(rng),
        pose_stamp_s=1.7e9 + 0.05,
        velocity=RingVelocity(center_m_s=rng.normal(size=3), rate_rad_s=rng.normal(size=3), covariance=square(rng, 5)),
        protection=protection(),
        measurement=complete_measurement(rng),
        priors=Priors(
            assumptions=Assumptions(
                motion=MotionPrior(speed_sd_m_s=0.025, rate_sd_rad_s=0.04),
                ring_tolerance_m=1e-4,
                stability=RigStability(plane_tilt_rad=1e-4, plane_distance_m=2e-5, focal_ratio=1e-4),
            ),
            radius=RadiusPrior(inner_m=math.nan, outer_m=0.597, inner_sd_m=math.nan, outer_sd_m=0.0005, source="given"),
            rig_covariance=True,
            moved_planes={
                "left": PlaneCorrection(change=np.array([2e-3, 0.0, 1e-4]), covariance=np.diag([1e-9, 2e-9, 3e-10]))
            },
            bent_planes={"right": LaserBow(per_rad=-0.0114, sd_per_rad=2e-4)},
            regularization=rng.normal(size=(2, 13)),
        ),
        plane_evidence=PlaneEvidence(
            parameters=("left.tilt_1", "focal_ratio"),
            rows=rng.normal(size=(4, 3)),
            normal=np.array([0.0, 0.6, -0.8]),
            place_m=rng.normal(size=3),
        ),
        lasers={"left": LaserState.USED, "middle": LaserState.PARTLY, "right": LaserState.OUT_OF_VIEW},
        rejected=(Rejection(what="point", laser="middle", edge="inner", chi2=40.0), Rejection(what="radius")),
        rig_health={"left": 0.9, "middle": math.nan, "right": 1.1},
        shots_dropped=2,
        stage_s={"detect": 0.01, "pose": 0.004},
        lines_skipped=0,
    )


def line(pose: RingPose | None, **changes: Any) -> PoseLine:
    """A line with this pose, in which little else is known."""
    flags = PoseFlag(0) if pose is None else pose.flags
    given = {
        "software": "ringpose 0.1.0",
        "shot": "a",
        "stamp_s": 1.7e9,
        "pose": pose,
        "flags": flags,
        "latency_s": 0.02,
        "rig": "0" * 64,
    }
    return PoseLine(**(given | changes))


def complete_track(rng: np.random.Generator) -> TrackLine:
    """A track line in which everything is known."""
    attempts = (
        Attempt(shot="a", stamp_s=1.7e9, fusion_status=FusionStatus.FUSED, test_ratio=0.3),
        Attempt(shot="b", stamp_s=math.nan, fusion_status=FusionStatus.TOO_OLD, test_ratio=math.nan, reason="too old"),
    )
    pose = complete_pose(rng)
    return TrackLine(
        software="ringpose 0.1.0",
        stamp_s=1.7e9 + 0.2,
        attempts=attempts,
        measurement_stamp_s=1.7e9,
        validity=Validity.PREDICTED,
        frame="base",
        pose=pose,
        flags=pose.flags,
        velocity=RingVelocity(center_m_s=rng.normal(size=3), rate_rad_s=rng.normal(size=3), covariance=square(rng, 5)),
        protection=protection(),
        grasp=GraspState(point_m=rng.normal(size=3), velocity_m_s=rng.normal(size=3), covariance=square(rng, 6)),
        next_tick=NextTick(
            stamp_s=1.7e9 + 0.4, grasp_m=rng.normal(size=3), normal=pose.normal, covariance=square(rng, 5)
        ),
        hypotheses=(SideHypothesis(side=-1, weight=0.9, center_m=rng.normal(size=3)),),
        model=MotionModel.PRECESSION,
        process_noise=ProcessNoise(velocity_m2_s3=1e-6, rate_rad2_s3=1e-5),
        log_evidence={MotionModel.CONSTANT_VELOCITY: -80.0, MotionModel.PRECESSION: -73.5},
        camera="robot_poses",
        capture_probability=0.9,
        resets=2,
        lines_skipped=1,
        rig="0" * 64,
    )


VERSION_1 = {
    "schema": "ringpose/pose/1",
    "shot": "a",
    "stamp_s": 1.7e9,
    "frame": "camera",
    "status": "degraded",
    "reason": None,
    "flags": ["center_weak"],
    "pose": {
        "center_m": [0.0, 0.0, 1.0],
        "normal": [0.0, 0.6, -0.8],
        "pitch_rad": 0.0,
        "yaw_rad": 0.0,
        "radius_inner_m": 0.5,
        "radius_outer_m": None,
        "grasp_m": None,
        "covariance": None,
        "ring_posterior": None,
        "method": "ml",
        "residual_rms_px": 0.1,
        "condition": 20.0,
    },
    "laser_health": {"left": 0.9, "right": None},
    "dropped": 3,
    "latency_s": 0.1,
    "rig": None,
}


def break_points(rng: np.random.Generator) -> BreakPoints:
    """Break points of three lasers; one was not found."""
    lasers = 3
    position = rng.normal(size=(lasers, 2, 2))
    position[1, 0] = math.nan
    root = rng.normal(size=(lasers, 2, 2, 2))
    covariance = root @ root.swapaxes(-1, -2)
    covariance[1, 0] = math.nan
    return BreakPoints(
        position_px=position,
        covariance_px2=covariance,
        flags=rng.integers(0, 16, (lasers, 2)),
        face_start_undistorted_px=rng.normal(size=(lasers, 2)),
        face_end_undistorted_px=rng.normal(size=(lasers, 2)),
        face_sigma_px=rng.uniform(size=(lasers, 2)),
        labelled=True,
        stamp_s=np.array([1.7e9, math.nan, *rng.uniform(1.7e9, 1.8e9, lasers - 2)]),
    )


def full_detection(rng: np.random.Generator, centers: int = 50) -> Detection:
    """A detection that has everything."""
    piece = np.sort(rng.integers(0, 4, centers))
    repeated = replace(break_points(rng), labelled=True)
    return Detection(
        software="ringpose 0.1.0",
        shot="a",
        stamp_s=1.7e9,
        advice="shorter exposure",
        break_points=replace(break_points(rng), repeated=repeated, opposite=break_points(rng)),
        ring=JudgedRing(
            origin_m=rng.normal(size=3),
            axes=np.linalg.qr(rng.normal(size=(3, 3)))[0],
            curvature_per_m=1.7,
            half_band_m=0.015,
            velocity_m_s=rng.normal(size=3),
            rate_rad_s=rng.normal(size=3),
            stamp_s=1.7e9,
        ),
        stripes=Stripes(
            position_px=rng.normal(size=(centers, 2)),
            sigma_px=rng.normal(size=centers),
            peak_dn=rng.normal(size=centers),
            piece=piece,
            laser=np.array([0, -1, 2, 1]),
            stamp_s=rng.uniform(1.7e9, 1.8e9, 4),
        ),
        segments=Segments(
            start_px=rng.normal(size=(7, 2)),
            end_px=rng.normal(size=(7, 2)),
            support=rng.integers(1, 99, 7),
            stamp_s=rng.uniform(1.7e9, 1.8e9, 7),
        ),
        ring_edges=ring_edges(rng),
        lasers_on=np.array([True, False, True]),
        rejected=(Rejection(what="stripe", laser="middle", chi2=41.5), Rejection(what="assignment")),
        rig="5b" * 32,
    )


def complete_truth(rng: np.random.Generator) -> Truth:
    """The truth of a moving ring of which one break point is not visible."""
    points = rng.normal(size=(3, 2, 2))
    points[1, 0] = np.nan
    center_m, normal = np.array([0.1, 0.2, 0.5]), np.array([0.0, 0.6, -0.8])
    frame = TruthFrame(stamp_s=3.0, center_m=center_m, normal=normal, break_points_px=points)
    return Truth(
        shot="a", expect="partial", center_m=center_m, normal=normal, radius_inner_m=0.567, radius_outer_m=0.597,
        break_points_px=points, stamp_s=3.0, velocity_m_s=rng.normal(size=3), angular_velocity_rad_s=np.zeros(3),
        frames=(frame, replace(frame, stamp_s=4.0, break_points_px=None)),
        groups={"rig": "B", "distance_m": 0.5, "foil": True, "count": 3},
    )  # fmt: skip


def ring_edges(rng: np.random.Generator, count: int = 9) -> RingEdgePoints:
    """Points on both edges."""
    return RingEdgePoints(
        position_px=rng.normal(size=(count, 2)),
        normal=rng.normal(size=(count, 2)),
        sigma_px=rng.uniform(size=count),
        edge=rng.integers(0, 2, count),
        stamp_s=rng.uniform(1.7e9, 1.8e9, count),
    )
