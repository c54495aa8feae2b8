"""Stripes -> points in space: each centre of a stripe is the pixel of a point in its laser's light plane.

A point's covariance has two parts (ringpose-method(7), section 1): the error of its own centre, along the line that its
pixel's column has in the light plane, and errors that it shares with others, of camera, light planes, mount and robot.
The first averages out over many points, the second does not.
"""

from math import isfinite

import numpy as np

from ringpose.estimate.nuisance import point_jacobians, points_wrt_errors, rig_errors
from ringpose.geometry.camera_motion import CameraMotion
from ringpose.geometry.rays import rays, undistorted_pixels
from ringpose.geometry.rotations import skew
from ringpose.geometry.sheets import light_normals, sheet_points
from ringpose.types.arrays import Array, Bool, Float64, Int64
from ringpose.types.assumptions import RigStability
from ringpose.types.detection import UNLABELLED, BreakPoints, Detection, Stripes, stamps_of
from ringpose.types.options import PoseFrame
from ringpose.types.points import NO_POINTS, LeftOut, ShotPoints, StripePoints
from ringpose.types.rig import NO_ROBOT_POSES, Rig

ON_FACE_SIGMAS = 5.0
"""Distance from the line of a stripe on the ring's face within which a centre is on it. With half of it, one centre in
80 is left out; with twice as much, more centres are on the lines of two lasers, and are left out where these cross."""


def stripe_points(
    detection: Detection,
    rig: Rig,
    stability: RigStability,
    frame: PoseFrame = PoseFrame.CAMERA,
    camera: CameraMotion | None = None,
) -> ShotPoints:
    """The points of all stripes of a shot whose laser is known, each at the time of its frame.

    The frames tool and base need the rig's mount, and `camera`, the motion by the robot's poses, unless the mount is in
    that frame. A target that moves is where it was in each frame.
    """
    points, left_out = NO_POINTS, LeftOut()
    if detection.stripes is not None and len(detection.stripes.piece):
        points, left_out = _points_in_camera(detection.stripes, detection.break_points, rig, stability)
    if frame is not PoseFrame.CAMERA:
        if camera is None and rig.mount is not None:
            camera = CameraMotion(poses=NO_ROBOT_POSES, mount=rig.mount)
        points, unknown = _in_frame(points, frame, camera)
        left_out = LeftOut(
            laser_unknown=left_out.laser_unknown, no_intersection=left_out.no_intersection, no_robot_pose=unknown
        )
    return ShotPoints(
        shot=detection.shot,
        stamp_s=detection.stamp_s,
        frame=frame,
        lasers=rig.lasers.names,
        points=points,
        left_out=left_out,
        calibration_covariance=rig.covariance is not None and bool(np.isfinite(rig.covariance.data).all()),
        rig=rig.sha256,
    )


def _points_in_camera(
    stripes: Stripes, break_points: object, rig: Rig, stability: RigStability
) -> tuple[StripePoints, LeftOut]:
    laser = _lasers_of_centers(stripes, break_points if isinstance(break_points, BreakPoints) else None, rig)
    position_m = np.full((len(laser), 3), np.nan)
    known = laser != UNLABELLED
    position_m[known] = sheet_points(rays(stripes.position_px[known], rig.camera), laser[known], rig)
    kept = np.isfinite(position_m).all(axis=1)
    noise_m, common_m2 = _errors(position_m[kept], stripes.sigma_px[kept], laser[kept], rig, stability)
    return StripePoints(
        position_m=position_m[kept],
        covariance_m2=noise_m[:, :, None] * noise_m[:, None, :] + common_m2,
        noise_m=noise_m,
        intensity_dn=stripes.peak_dn[kept],
        laser=laser[kept],
        stamp_s=stamps_of(stripes)[stripes.piece[kept]],
        position_px=stripes.position_px[kept],
    ), LeftOut(laser_unknown=int((~known).sum()), no_intersection=int((known & ~kept).sum()))


def _errors(
    points: Float64[Array, "n xyz=3"],
    sigma_px: Float64[Array, "n"],
    laser: Int64[Array, "n"],
    rig: Rig,
    stability: RigStability,
) -> tuple[Float64[Array, "n xyz=3"], Float64[Array, "n xyz=3 xyz=3"]]:
    """The displacement of each point by one sigma of its centre, and its covariance by errors of the rig.

    The centre is measured along the image's columns, or along its rows where stripes run along columns: across that it
    has no error.
    """
    if not len(points):
        return np.zeros((0, 3)), np.zeros((0, 3, 3))
    jacobians = point_jacobians(points, light_normals(points, laser, rig), rig.camera)
    noise_m = jacobians.wrt_pixel[:, :, 0 if rig.stripes_along_columns else 1] * sigma_px[:, None]
    errors = rig_errors(rig, stability)
    common_m = (
        np.zeros((len(points), 3, 0)) if errors is None else points_wrt_errors(points, laser, rig, jacobians, errors)
    )
    return noise_m, common_m @ common_m.swapaxes(1, 2)


def _lasers_of_centers(stripes: Stripes, found: BreakPoints | None, rig: Rig) -> Int64[Array, "center"]:
    """The laser of each centre: that of its frame, or that of the one stripe on the ring's face on which it is."""
    laser = stripes.laser[stripes.piece]
    if found is None or (laser != UNLABELLED).all():
        return laser
    position_px = undistorted_pixels(stripes.position_px, rig.camera)
    on = np.zeros((len(rig.lasers.names), len(laser)), dtype=bool)
    for arc in found.arcs:
        for number in np.flatnonzero(np.isfinite(arc.face_start_undistorted_px[:, 0])):
            ends_px = np.stack([arc.face_start_undistorted_px[number], arc.face_end_undistorted_px[number]])
            on[number] |= _on_line(position_px, stripes.sigma_px, ends_px, arc.face_sigma_px[number])
    assigned = np.where(on.sum(axis=0) == 1, on.argmax(axis=0), UNLABELLED)
    return np.where(laser == UNLABELLED, assigned, laser)


def _on_line(
    position_px: Float64[Array, "n xy=2"],
    sigma_px: Float64[Array, "n"],
    ends_px: Float64[Array, "end=2 xy=2"],
    end_sigma_px: Float64[Array, "end=2"],
) -> Bool[Array, "n"]:
    """Which centres are on a straight line between its ends."""
    length = float(np.linalg.norm(ends_px[1] - ends_px[0]))
    along = (ends_px[1] - ends_px[0]) / length
    offset = position_px - ends_px[0]
    share = offset @ along / length
    off_px = np.abs(offset @ np.array([-along[1], along[0]]))
    sigma = np.hypot(sigma_px, (1.0 - share) * end_sigma_px[0] + share * end_sigma_px[1])
    return np.asarray((share >= 0.0) & (share <= 1.0) & (off_px < ON_FACE_SIGMAS * sigma))


def _in_frame(points: StripePoints, frame: PoseFrame, camera: CameraMotion | None) -> tuple[StripePoints, int]:
    """The points in the frame of tool or base, each as the camera stood at its time, with the error of its place there.

    A small turn w and shift d of the camera, which stands at t, move a point p by w x (p - t) + d. Also the number of
    those at whose time the camera's place is not known, which are left out.
    """
    position_m, covariance_m2 = points.position_m.copy(), points.covariance_m2.copy()
    noise_m, known = points.noise_m.copy(), np.zeros(len(position_m), dtype=bool)
    for stamp_s in np.unique(points.stamp_s):
        here = (points.stamp_s == stamp_s) if isfinite(stamp_s) else np.isnan(points.stamp_s)
        where = None if camera is None else camera.in_frame(frame, float(stamp_s))
        if where is None:
            continue
        frame_from_camera, root = where
        rotation, origin_m = frame_from_camera[:3, :3], frame_from_camera[:3, 3]
        position_m[here] = points.position_m[here] @ rotation.T + origin_m
        noise_m[here] = points.noise_m[here] @ rotation.T
        lever_m = position_m[here] - origin_m
        wrt_camera = np.concatenate([-_skews(lever_m), np.broadcast_to(np.eye(3), (len(lever_m), 3, 3))], axis=2) @ root
        covariance_m2[here] = rotation @ points.covariance_m2[here] @ rotation.T
        covariance_m2[here] += wrt_camera @ wrt_camera.swapaxes(1, 2)
        known[here] = True
    return StripePoints(
        position_m=position_m[known],
        covariance_m2=covariance_m2[known],
        noise_m=noise_m[known],
        intensity_dn=points.intensity_dn[known],
        laser=points.laser[known],
        stamp_s=points.stamp_s[known],
        position_px=points.position_px[known],
    ), int((~known).sum())


def _skews(vectors: Float64[Array, "n xyz=3"]) -> Float64[Array, "n 3 3"]:
    """The matrix [v]x of each vector."""
    return np.array([skew(vector) for vector in vectors]).reshape(-1, 3, 3)
