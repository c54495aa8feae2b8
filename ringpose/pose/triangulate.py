"""Break points in the image -> points in space (ringpose-method(7), section 1)."""

from ringpose.geometry.rays import intersect, rays
from ringpose.types.break_points import BreakPoints
from ringpose.types.rig import Rig
from ringpose.types.ring_points import RingPoints


def triangulated(break_points: BreakPoints, rig: Rig) -> RingPoints:
    """Where the ray through each break point meets its laser's plane.

    NaN where a break point was not seen, and where its ray runs along the plane or meets it behind the camera.
    """
    directions = rays(break_points.position_px, rig.camera)
    position = intersect(directions, rig.lasers.normal[:, None], rig.lasers.distance_m[:, None])
    return RingPoints(position_m=position)
