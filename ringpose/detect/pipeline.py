"""Shot -> break points, in the order of MATH.md section 3."""

import numpy as np

from ringpose.detect.break_points import break_points
from ringpose.detect.faces import ring_face
from ringpose.detect.frames import LaserImage, laser_images
from ringpose.detect.stripe_centers import find_stripes
from ringpose.detect.tracks import straight_tracks
from ringpose.geometry.rays import undistorted_pixels
from ringpose.types.break_points import BreakPoints, Detection, NoBreakPoints
from ringpose.types.frame import Shot
from ringpose.types.rig import Rig
from ringpose.types.stripes import UNLABELLED, Stripes

DARK_DN = 8
"""A frame whose brightest pixels stay below this shows nothing at all."""


def detect(shot: Shot, rig: Rig) -> Detection:
    """Stripes and break points of a shot; a shot without break points says why."""
    images = laser_images(shot, len(rig.lasers.names))
    if not images:
        return Detection(shot=shot.name, stamp_s=shot.measured_at_s, break_points=NoBreakPoints.NO_LASER_FRAME)
    stripes = _all_stripes(images)
    found = _found(stripes, images, rig, shot.saturation_dn)
    return Detection(shot=shot.name, stamp_s=shot.measured_at_s, break_points=found, stripes=stripes)


def _all_stripes(images: list[LaserImage]) -> Stripes:
    """The stripes of all frames in one record, with the laser where a frame shows only one."""
    parts, pieces = [], 0
    for image in images:
        stripes = find_stripes(image.lit, image.dark)
        label = image.lasers[0] if image.labelled else UNLABELLED
        parts.append((stripes, stripes.piece + pieces, np.full_like(stripes.laser, label)))
        pieces += len(stripes.laser)
    return Stripes(
        position_px=np.concatenate([stripes.position_px for stripes, _, _ in parts]),
        sigma_px=np.concatenate([stripes.sigma_px for stripes, _, _ in parts]),
        peak_dn=np.concatenate([stripes.peak_dn for stripes, _, _ in parts]),
        piece=np.concatenate([piece for _, piece, _ in parts]),
        laser=np.concatenate([laser for _, _, laser in parts]),
    )


def _found(
    stripes: Stripes, images: list[LaserImage], rig: Rig, saturation_dn: int
) -> BreakPoints | NoBreakPoints:
    """The break points among the stripes, or why there are none."""
    if not len(stripes.piece):
        return _why_no_stripe(images, saturation_dn)
    points = undistorted_pixels(stripes.position_px, rig.camera)
    tracks = straight_tracks(stripes, points, rig.camera.image_width)
    centers = np.column_stack([points, stripes.laser[stripes.piece].astype(np.float64)])
    unlabelled = [laser for image in images if not image.labelled for laser in image.lasers]
    face = ring_face(tracks, centers, unlabelled, rig)
    if face is None:
        return NoBreakPoints.NO_RING
    if face.ambiguous:
        return NoBreakPoints.AMBIGUOUS_LABELS
    shows = {laser: image for image in images for laser in image.lasers}
    return break_points(face, shows, rig, saturation_dn)


def _why_no_stripe(images: list[LaserImage], saturation_dn: int) -> NoBreakPoints:
    if all(image.lit.max() < DARK_DN for image in images):
        return NoBreakPoints.IMAGE_DARK
    if all(np.median(image.lit) >= saturation_dn for image in images):
        return NoBreakPoints.IMAGE_SATURATED
    return NoBreakPoints.NO_STRIPE
