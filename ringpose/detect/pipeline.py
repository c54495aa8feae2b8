"""Shot -> break points, in the order of ringpose-method(7), section 3.

Stripes are extracted from the difference images (in the whole frames, or in windows about predicted stripes), the
segments on the ring's face are selected and assigned to lasers, and their endpoints are refined. Shots whose stripes
would triangulate behind the camera are rejected: the images are upside down, mirrored or of another rig.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import product

import numpy as np

from ringpose.detect.break_points import BEYOND_COLUMNS, break_points, ends_clear, without_outliers
from ringpose.detect.concentric_faces import several_faces
from ringpose.detect.difference_images import (
    BAND_PX,
    VISIBLE_SHARE,
    LaserImage,
    exposure_advice,
    hidden_by_saturation,
    laser_advice,
    laser_images,
    repeated_image,
    saturated_along_stripes,
)
from ringpose.detect.motion import RingMotion, ring_motion
from ringpose.detect.rim import Face, planes_per_m, ring_face
from ringpose.detect.ring_edges import detect_ring_edges
from ringpose.detect.stripes import (
    BLOCK,
    LONG_COLUMNS,
    MAX_GAP,
    SAME_STRIPE_PX,
    find_stripes,
    stripe_line_segments,
    without_ghosts,
)
from ringpose.estimate.ring_estimate import STRIPES_OF_A_PLANE
from ringpose.estimate.solver import CERTAIN_SIGMAS
from ringpose.geometry.camera_motion import CameraMotion
from ringpose.geometry.rays import project, undistorted_rays
from ringpose.kernels.lines import (
    CENTERS,
    FARTHEST_M,
    LASER,
    MIDDLE_X,
    MIDDLE_Y,
    NEAREST_M,
    SLOPE,
    X_END,
    X_START,
)
from ringpose.optics.feature_errors import AGREEMENT
from ringpose.types.arrays import Array, Bool, Float64, Int32, Int64
from ringpose.types.assumptions import USUAL, Assumptions, motion_prior
from ringpose.types.detection import (
    UNLABELLED,
    BreakPointFlag,
    BreakPoints,
    Detection,
    JudgedRing,
    NoBreakPoints,
    Rejection,
    RingEdgePoints,
    Segments,
    Stripes,
    SubtractedGhost,
    joined_stripes,
    stamps_of,
)
from ringpose.types.image import Frame, Shot
from ringpose.types.options import StripeSource
from ringpose.types.rig import Camera, LaserGhost, Rig

MOVED_PX = 0.5
"""Displacement of the ring's edges from which the background of another frame is not subtracted."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Prior:
    """What is known about a shot before its images are searched; nothing by default."""

    assumptions: Assumptions | None = None
    """None for the usual ones about this shot."""
    camera: CameraMotion | None = None
    """The camera's motion, if a robot moves it; then a ring at rest moves in the images, too."""
    predicted: BreakPoints | None = None
    """Stripes in windows about which the shot is searched first; if `labelled`, they also assign the stripes of frames
    with several lasers on."""
    background: Frame | None = None
    """A frame without lasers of an earlier shot, for a shot without one: it is subtracted, but the edges that it shows
    are not measured again."""
    stripes_of: Callable[[LaserImage], Stripes | None] | None = None
    """The stripes of a whole frame, if they were found before the shot was complete; those of the turned frame if the
    stripes run along columns."""
    ghosts: tuple[SubtractedGhost, ...] = ()
    """Ghosts of stripes that earlier shots had."""


NOTHING_KNOWN = Prior()


class Stop(Exception):
    """A step of the detection cannot go on."""

    def __init__(self, reason: NoBreakPoints) -> None:
        super().__init__(reason)
        self.reason = reason


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class View:
    """What every step of the detection looks at: a shot, its frames with lasers on, and what is assumed about it."""

    shot: Shot
    rig: Rig
    images: Sequence[LaserImage]
    assumptions: Assumptions
    camera: CameraMotion | None
    still: bool
    """Whether the ring cannot move in the images."""
    ghosts: tuple[SubtractedGhost, ...] = ()
    """Ghosts of the stripes: first those of earlier shots, then those that were subtracted from the frames."""

    @property
    def saturation_dn(self) -> int:
        """Grey value from which a pixel is saturated."""
        return self.images[0].saturation_dn

    @property
    def ghosts_of_lasers(self) -> dict[int, LaserGhost]:
        """The ghosts that the rig states, by the number of the laser."""
        names = self.rig.lasers.names
        return {names.index(name): ghost for name, ghost in self.rig.ghosts.items()}

    def unlabelled_lasers(self) -> list[int]:
        """Lasers that are on in frames with others, so that their stripes are not assigned by the frame."""
        return [laser for image in self.images if image.label == UNLABELLED for laser in image.lasers]


def detect(
    shot: Shot,
    rig: Rig,
    prior: Prior = NOTHING_KNOWN,
    *,
    source: StripeSource = StripeSource.CENTERS,
    edges: bool = True,
    pixel_ends: bool = False,
) -> Detection:
    """Stripes, break points (or the reason why there are none) and, unless `edges` is false, the ring's visible edges.

    With `pixel_ends` the break points are those of the paper's line detector, once the ring is found.

    The steps are those of ringpose-method(7), section 3.
    """
    if rig.stripes_along_columns:
        return _detected_along_columns(shot, rig, prior, source, edges=edges, pixel_ends=pixel_ends)
    view = shot_view(shot, rig, prior)
    blank = blank_detection(view)
    if not view.images:
        return blank
    search = ring_near_prediction(view, prior) or ring_in_whole_frames(view, prior, source)
    view = search.view
    seen = replace(blank, stripes=search.stripes, segments=search.segments, ghosts=view.ghosts)
    try:
        named, visible, missing = visible_edges(search.judged(), search, view, source, wanted=edges)
        clear = confirmed(named, visible, view)
        points = clear if source is StripeSource.SEGMENTS else with_repetition(clear, view, search.motion)
        if pixel_ends:
            points = _with_pixel_ends(points, view)
    except Stop as stop:
        reason = explained(stop.reason, search.stripes, view)
        return replace(seen, break_points=reason, advice=_advice(reason, search.stripes, view))
    return replace(
        seen,
        break_points=points,
        ring_edges=visible if edges else None,
        ring=search.ring if np.array_equal(points.flags, search.judged().flags) else None,  # named as it was judged
        rejected=(*search.rejected, *([Rejection(what="edge")] if edges and missing else [])),
        advice=exposure_advice(points, shot, view.images),
    )


def _advice(reason: NoBreakPoints, stripes: Stripes, view: View) -> str:
    """What would help, and the limits of the rig where nothing looks like a face."""
    phrases = [exposure_advice(reason, view.shot, view.images)]
    if reason is NoBreakPoints.NO_RING:
        from ringpose.detect.resolution import resolution_advice  # not imported where there is a ring

        phrases.append(resolution_advice(stripes, view.images, view.rig))
    if reason in (NoBreakPoints.NO_RING, NoBreakPoints.SURFACE_IN_FRONT):  # a stripe on the face may be too faint
        phrases.append(laser_advice(stripes, view.rig))
    return "; ".join(filter(None, phrases))


def _detected_along_columns(
    shot: Shot, rig: Rig, prior: Prior, source: StripeSource, *, edges: bool, pixel_ends: bool
) -> Detection:
    """What `detect` finds in the shot turned by 90 degrees, in the pixels of the shot as it was given."""
    from ringpose.geometry.quarter_turn import rig_along_rows, to_columns, to_rows  # for few rigs

    turn, predicted = to_rows(rig.camera), prior.predicted
    turned = replace(
        prior,
        camera=turn.motion(prior.camera),
        predicted=None if predicted is None else turn.break_points(predicted),
        background=turn.frame(prior.background),
        ghosts=turn.ghosts(prior.ghosts),
    )
    detection = detect(turn.shot(shot), rig_along_rows(rig), turned, source=source, edges=edges, pixel_ends=pixel_ends)
    return to_columns(rig.camera).detection(detection)


def shot_view(shot: Shot, rig: Rig, prior: Prior) -> View:
    """The frames of a shot that are searched, with their backgrounds; no frames if the shot is lost."""
    assumptions = prior.assumptions or USUAL.about_shot(rig.stability, still=shot.still)
    return View(
        shot=shot,
        rig=rig,
        images=[] if shot.is_lost else laser_images(shot, len(rig.lasers.names), prior.background),
        assumptions=assumptions,
        camera=prior.camera,
        still=assumptions.motion is None and prior.camera is None,
        ghosts=prior.ghosts,
    )


def blank_detection(view: View) -> Detection:
    """The detection of a shot before it is searched, which is also that of one without a frame to search."""
    shot, lasers = view.shot, view.rig.lasers.names
    return Detection(
        shot=shot.name,
        stamp_s=shot.measured_at_s,
        break_points=NoBreakPoints.AMBIENT_CHANGED if shot.is_lost else NoBreakPoints.NO_LASER_FRAME,
        lasers_on=(np.bitwise_or.reduce(shot.lasers, initial=0) >> np.arange(len(lasers))) & 1 == 1,
        still=shot.still,
        ambient_changed=shot.ambient_changed,
        rig=view.rig.sha256,
    )


# Stripes, face, ends, and the ring that they agree with


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RingSearch:
    """The stripes of a shot, and the break points on those of them that agree with one ring."""

    view: View
    """The shot with the frames in which they were found, from which ghosts are subtracted."""
    stripes: Stripes
    segments: Segments | None = None
    """The line segments that the stripes were made from, if any."""
    break_points: BreakPoints | NoBreakPoints
    rejected: tuple[Rejection, ...] = ()
    """What does not agree with the ring."""
    motion: RingMotion | None = None
    """The ring's motion, if the shot shows it."""
    ring: JudgedRing | None = None

    def judged(self) -> BreakPoints:
        """The break points that agree with one ring; raises `Stop` if there are none."""
        if isinstance(self.break_points, NoBreakPoints):
            raise Stop(self.break_points)
        return self.break_points


def ring_near_prediction(view: View, prior: Prior) -> RingSearch | None:
    """The ring by the stripes in windows about the predicted ones; None without all of the predicted break points."""
    predicted = prior.predicted
    searched = None if predicted is None else _predicted_stripes(view, predicted)
    if predicted is None or searched is None:
        return None
    search = _ring_search(*searched, [] if predicted.labelled else view.unlabelled_lasers())
    points = search.break_points
    if isinstance(points, NoBreakPoints):
        return None
    whole = any(bool((arc.seen >= predicted.seen).all()) for arc in (points, points.arcs_exchanged()))
    return search if whole else None


def ring_in_whole_frames(view: View, prior: Prior, source: StripeSource) -> RingSearch:
    """The ring by the stripes in the whole frames."""
    view, stripes, segments = _all_stripes(view, source, prior.stripes_of)
    return replace(_ring_search(view, stripes, view.unlabelled_lasers()), segments=segments)


def _ring_search(view: View, stripes: Stripes, unlabelled: Sequence[int]) -> RingSearch:
    """The break points on the stripes that lie on one ring; `unlabelled`: lasers whose stripes are not assigned."""
    try:
        return _judged_ring(view, stripes, unlabelled)
    except Stop as stop:
        return RingSearch(view=view, stripes=stripes, break_points=stop.reason)


def _judged_ring(view: View, stripes: Stripes, unlabelled: Sequence[int]) -> RingSearch:
    """Face, ends, and the outlier test by one ring.

    The background of a moving ring is not subtracted where the stripes end: it would leave the ring's edges, displaced.
    """
    rig, saturation_dn = view.rig, view.saturation_dn
    if not len(stripes.piece):
        raise Stop(_why_no_stripe(view.images))
    segments = stripe_line_segments(stripes, rig.camera)
    face = select_face(segments, unlabelled, rig)
    ends = break_points(face, segments, view.images, rig, saturation_dn)
    if saturated_along_stripes(ends, view.images, saturation_dn):
        raise Stop(NoBreakPoints.HIDDEN_BY_SATURATION)
    prior = view.assumptions.motion or motion_prior()
    motion = None if view.still or view.shot.lasers.all() else ring_motion(ends, view.shot, rig, prior)
    unmoved = view.images if motion is None else [_without_moved_background(image, motion) for image in view.images]
    if unmoved != view.images:
        ends = break_points(face, segments, unmoved, rig, saturation_dn)
    judged = without_outliers(ends, rig, view.assumptions, view.camera)
    points = judged.break_points
    if not isinstance(points, NoBreakPoints) and several_faces(face, segments, unlabelled, judged.ring, rig):
        points = replace(points, flags=points.flags | np.where(points.seen, int(BreakPointFlag.SEVERAL_FACES), 0))
    displaced = [rig.lasers.names[laser] for laser in face.displaced]
    return RingSearch(
        view=view,
        stripes=stripes,
        break_points=points,
        rejected=(*judged.rejected, *(Rejection(what="stripe", laser=name) for name in displaced)),
        motion=motion,
        ring=judged.ring,
    )


# The ring's visible edges


def visible_edges(
    points: BreakPoints, search: RingSearch, view: View, source: StripeSource, *, wanted: bool
) -> tuple[BreakPoints, RingEdgePoints | None, bool]:
    """The break points with inner and outer edge resolved, the visible edges, and whether light should show them.

    They are also searched if they are not wanted but the ends are not clear. Raises `Stop` if they are straight.
    """
    if source is StripeSource.SEGMENTS or (not wanted and ends_clear(points)):
        return points, None, False
    edges = detect_ring_edges(
        points, view.shot, search.stripes, view.rig, view.assumptions, view.camera, search.motion, search.ring
    )
    if isinstance(edges.break_points, NoBreakPoints):
        raise Stop(edges.break_points)
    return edges.break_points, edges.points, edges.missing


def confirmed(points: BreakPoints, visible: RingEdgePoints | None, view: View) -> BreakPoints:
    """The break points; raises `Stop` if they are not enough to show a ring.

    Visible edges beside several stripes stand for clear ends only without a background frame, where its texture hides
    the ends: the shadow of a ring on a flat body has the edges of a ring, but beside it the stripes go on, fainter.
    """
    several = int(points.seen.any(axis=1).sum()) > 1
    by_edges = visible is not None and several and any(image.dark is None for image in view.images)
    without_ends = visible is None and not any(bool(arc.seen.any()) for arc in points.arcs)
    if without_ends or (not by_edges and not ends_clear(points)):
        raise Stop(NoBreakPoints.NO_RING)
    if visible is None and hidden_by_saturation(points, view.images, view.saturation_dn):
        raise Stop(NoBreakPoints.HIDDEN_BY_SATURATION)
    return points


def _with_pixel_ends(points: BreakPoints, view: View) -> BreakPoints:
    """The break points as the paper's line detector gives them; it is imported only if needed."""
    from ringpose.detect.line_segments import with_pixel_ends

    return with_pixel_ends(points, view.images)


# Stripes


def _predicted_stripes(view: View, predicted: BreakPoints) -> tuple[View, Stripes] | None:
    """The stripes in windows about the predicted ones, without ghosts; None if none is predicted."""
    rig = view.rig
    bands = {image.lasers: predicted_bands(predicted, image.lasers, rig.camera) for image in view.images}
    if all(each is None for each in bands.values()):
        return None

    def near_predicted(image: LaserImage) -> Stripes:
        of_image = bands[image.lasers]
        return _stripes_in(image, rig.camera, np.zeros((0, 4), dtype=np.int32) if of_image is None else of_image)

    view, parts = _without_ghosts(view, [near_predicted(image) for image in view.images], near_predicted)
    parts = [
        part if image.label != UNLABELLED or not predicted.labelled else _assigned(part, predicted, image, rig)
        for part, image in zip(parts, view.images, strict=True)
    ]
    return view, _joined(parts)


def _without_ghosts(
    view: View, parts: Sequence[Stripes], stripes_of: Callable[[LaserImage], Stripes]
) -> tuple[View, list[Stripes]]:
    """Frames and their stripes without ghosts and reflections, assigned to the lasers of frames with one."""
    images, clean, ghosts = without_ghosts(view.images, parts, view.ghosts, view.ghosts_of_lasers, stripes_of)
    return replace(view, images=images, ghosts=ghosts), [
        _labelled(part, image) for part, image in zip(clean, images, strict=True)
    ]


def _assigned(stripes: Stripes, predicted: BreakPoints, image: LaserImage, rig: Rig) -> Stripes:
    """The stripes with each piece assigned to the laser on whose predicted stripe most of its centres are.

    Pieces beside all of them, such as those on the body behind the ring, stay unassigned.
    """
    x, y = stripes.position_px.T
    near = np.zeros((len(stripes.laser), len(rig.lasers.names)))
    for laser, arc in product(image.lasers, predicted.arcs):
        ends = np.stack([arc.face_start_undistorted_px[laser], arc.face_end_undistorted_px[laser]])
        if not np.isfinite(ends).all():
            continue
        (left, first), (right, last) = sorted(project(undistorted_rays(ends, rig.camera), rig.camera).tolist())
        tolerance_px = CERTAIN_SIGMAS * float(arc.face_sigma_px[laser].max()) + SAME_STRIPE_PX
        on = np.abs(y - np.interp(x, [left, right], [first, last])) < tolerance_px
        on &= (x > left - tolerance_px) & (x < right + tolerance_px)
        near[:, laser] += np.bincount(stripes.piece[on], minlength=len(stripes.laser))
    return replace(stripes, laser=np.where(near.any(axis=1), near.argmax(axis=1), UNLABELLED))


def _all_stripes(
    view: View, source: StripeSource, searched: Callable[[LaserImage], Stripes | None] | None
) -> tuple[View, Stripes, Segments | None]:
    """The stripes of all frames in one record, without ghosts, and the line segments they were made from, if any."""
    if source is StripeSource.SEGMENTS:
        return replace(view, ghosts=()), *_stripes_between_segments(view.images)
    early = [None if searched is None else searched(image) for image in view.images]
    search = partial(_stripes_in, camera=view.rig.camera)
    parts = [part or search(image) for part, image in zip(early, view.images, strict=True)]
    view, parts = _without_ghosts(view, parts, search)
    return view, _joined(parts), None


def _stripes_in(image: LaserImage, camera: Camera, bands: Int32[Array, "band side=4"] | None = None) -> Stripes:
    """The stripes of a frame, everywhere or in some windows, without what goes on beyond these."""
    stripes = find_stripes(image.lit, image.dark, bands=bands, saturation_dn=image.threshold_scale_dn)
    return stripes if bands is None else _within_bands(stripes, bands, camera)


def _stripes_between_segments(images: Sequence[LaserImage]) -> tuple[Stripes, Segments]:
    """The stripes of all frames in one record, from pairs of line segments (the paper's method), and the segments.

    The line detector is imported only if needed.
    """
    from ringpose.detect.line_segments import stripes_between_segments

    pairs = [stripes_between_segments(image.lit, image.dark) for image in images]
    stripes = [_labelled(part, image) for (part, _), image in zip(pairs, images, strict=True)]
    segments = [
        replace(part, stamp_s=np.full(len(part.support), image.stamp_s))
        for (_, part), image in zip(pairs, images, strict=True)
    ]
    return _joined(stripes), _joined_segments(segments)


def _joined(parts: Sequence[Stripes]) -> Stripes:
    """Stripes of all frames in one record."""
    return parts[0] if len(parts) == 1 else joined_stripes(parts)


def _labelled(stripes: Stripes, image: LaserImage) -> Stripes:
    """The stripes with their time stamp, assigned to the laser of the frame if it has only one."""
    count = len(stripes.laser)
    return replace(stripes, laser=np.full(count, image.label), stamp_s=np.full(count, image.stamp_s))


def _joined_segments(parts: list[Segments]) -> Segments:
    """Segments of several frames in one record."""
    return Segments(
        start_px=np.concatenate([part.start_px for part in parts]),
        end_px=np.concatenate([part.end_px for part in parts]),
        support=np.concatenate([part.support for part in parts]),
        stamp_s=np.concatenate([stamps_of(part) for part in parts]),
    )


def with_repetition(points: BreakPoints, view: View, motion: RingMotion | None = None) -> BreakPoints:
    """The break points, and as `repeated` those of a frame with several lasers on that shows the same stripes again.

    The stripes of that frame are searched and assigned to lasers near those found. What was not measured the first time
    is left out.
    """
    rig, image = view.rig, repeated_image(view.shot, view.images)
    bands = None if image is None else predicted_bands(points, image.lasers, rig.camera)
    if image is None or bands is None:
        return points
    image = image if motion is None else _without_moved_background(image, motion)
    search = partial(_stripes_in, camera=rig.camera, bands=bands)
    (image,), (stripes,), _ = without_ghosts([image], [search(image)], view.ghosts, view.ghosts_of_lasers, search)
    if not len(stripes.piece):
        return points
    stripes = replace(stripes, laser=_nearest_lasers(stripes, points, image.lasers, rig.camera))
    segments = stripe_line_segments(stripes, rig.camera)
    face = ring_face(segments, (), rig)
    if face is None:
        return points
    again = break_points(face, segments, [image], rig, view.shot.saturation_dn)
    far_px = np.nansum(np.abs(again.position_px - points.position_px))
    if np.nansum(np.abs(again.position_px[:, ::-1] - points.position_px)) < far_px:
        again = again.with_edges_exchanged()
    unclear = again.flags & int(BreakPointFlag.UNCLEAR | BreakPointFlag.CLIPPED) != 0
    near = np.abs(again.position_px - points.position_px).max(axis=-1) < BAND_PX + BEYOND_COLUMNS
    kept = points.seen & ~unclear & near
    with_line = np.isfinite(points.face_start_undistorted_px)
    return replace(
        points,
        repeated=replace(
            again,
            position_px=np.where(kept[..., None], again.position_px, np.nan),
            covariance_px2=np.where(kept[..., None, None], again.covariance_px2, np.nan),
            face_start_undistorted_px=np.where(with_line, again.face_start_undistorted_px, np.nan),
            face_end_undistorted_px=np.where(with_line, again.face_end_undistorted_px, np.nan),
            face_sigma_px=np.where(with_line, again.face_sigma_px, np.nan),
            labelled=True,
        ),
    )


NEAREST_SHARE = 0.3
"""Largest distance of a repeated stripe from its first place, as a share of the distance between stripes."""


def _nearest_lasers(
    stripes: Stripes, points: BreakPoints, lasers: Sequence[int], camera: Camera
) -> Int64[Array, "piece"]:
    """The laser of each piece by the nearest line on the face; `UNLABELLED` for those that are not clearly near one."""
    lines = undistorted_rays(
        np.stack([points.face_start_undistorted_px, points.face_end_undistorted_px], axis=1), camera
    )
    start, end = project(lines, camera).swapaxes(0, 1)
    count = len(stripes.laser)
    centers = np.bincount(stripes.piece, minlength=count)
    middle = np.stack([np.bincount(stripes.piece, part, count) / centers for part in stripes.position_px.T], axis=1)
    known = [laser for laser in lasers if np.isfinite(start[laser, 0])]
    slope = (end - start)[known, 1] / (end - start)[known, 0]
    away_px = np.abs(start[known, 1] + slope * (middle[:, :1] - start[known, 0]) - middle[:, 1:])
    ranked = np.sort(away_px, axis=1)
    between_px = ranked[:, 1] if len(known) > 1 else np.full(count, np.inf)
    near = ranked[:, 0] < np.minimum(BAND_PX, NEAREST_SHARE * between_px)
    return np.where(near, np.array(known, dtype=np.int64)[away_px.argmin(axis=1)], UNLABELLED)


def _without_moved_background(image: LaserImage, motion: RingMotion) -> LaserImage:
    """The image, without background if the ring's edges have moved since the background was taken."""
    moved_px = motion.edge_speed_px_s * abs(image.stamp_s - image.dark_stamp_s)
    return replace(image, dark=None) if moved_px > MOVED_PX else image


def select_face(segments: Float64[Array, "segment column=12"], unlabelled: Sequence[int], rig: Rig) -> Face:
    """The stripes on the ring's face; `unlabelled`: lasers of unlabelled segments. Raises `Stop` if there are none."""
    face = ring_face(segments, unlabelled, rig)
    if not unlabelled and _masks_contradicted(face, segments, rig):
        raise Stop(NoBreakPoints.CONTRADICTED_MASKS)
    if (face is None or not face.is_confirmed) and stripes_behind_camera(segments, rig):
        raise Stop(NoBreakPoints.CONTRADICTED_RIG)
    if face is None:
        raise Stop(NoBreakPoints.NO_RING)
    if face.ambiguous:
        raise Stop(NoBreakPoints.AMBIGUOUS_LABELS)
    if face.behind:
        raise Stop(NoBreakPoints.SURFACE_IN_FRONT)
    return face


AS_IF_TURNED = (
    NoBreakPoints.CONTRADICTED_MASKS,
    NoBreakPoints.CONTRADICTED_RIG,
    NoBreakPoints.AMBIGUOUS_LABELS,
)
"""Reasons that images upside down have as well: this is looked for ..."""

AS_IF_EXCHANGED = (*AS_IF_TURNED, NoBreakPoints.HIDDEN_BY_SATURATION, NoBreakPoints.NO_RING)
"""... as frames in another order are with these."""


def explained(reason: NoBreakPoints, stripes: Stripes, view: View) -> NoBreakPoints:
    """The reason, or one for which the shot has evidence: exchanged frames, an image upside down."""
    with_dark = [image for image in view.images if image.dark is not None]
    if reason in AS_IF_EXCHANGED and with_dark and all(_dark_frame_lit(image) for image in with_dark):
        return NoBreakPoints.DARK_FRAME_LIT
    if reason not in AS_IF_TURNED:
        return reason
    rig = view.rig
    x, y = stripes.position_px.T
    turned_px = np.stack([x, rig.camera.image_height - 1 - y], axis=1)
    segments = stripe_line_segments(replace(stripes, position_px=turned_px), rig.camera)
    face = ring_face(segments, view.unlabelled_lasers(), rig)
    fits = face is not None and len(face.lasers) > STRIPES_OF_A_PLANE and not face.ambiguous and not face.behind
    return NoBreakPoints.UPSIDE_DOWN if fits else reason


BRIGHTER = 10
"""Ratio of pixels that are brighter without a laser to those brighter with it: one of them is a stripe's, the other is
noise or motion, and in 20 rendered shots at most 3 pixels to 2,000."""


def _dark_frame_lit(image: LaserImage) -> bool:
    """Whether the background shows stripes that the frame with the laser does not have."""
    if image.dark is None:
        return False
    step_dn = round(VISIBLE_SHARE * image.threshold_scale_dn)
    lit, dark = image.lit, image.dark
    brighter_lit = np.count_nonzero((lit > dark) & (lit - dark > step_dn))
    brighter_dark = np.count_nonzero((dark > lit) & (dark - lit > step_dn))
    if brighter_dark <= BRIGHTER * brighter_lit:
        return False
    return len(find_stripes(dark, lit, saturation_dn=image.threshold_scale_dn).piece) >= LONG_COLUMNS


def _masks_contradicted(face: Face | None, segments: Float64[Array, "segment column=12"], rig: Rig) -> bool:
    """Whether the stripes fit a ring of three lasers only under an assignment that contradicts the laser masks.

    Stripes on the body behind the ring fit one nearly always: it must explain clearly more than the face.
    """
    if face is not None and face.is_confirmed:
        return False
    unlabelled = segments.copy()
    unlabelled[:, LASER] = UNLABELLED
    other = ring_face(unlabelled, range(len(rig.lasers.names)), rig)
    explained = -math.inf if face is None else face.score + AGREEMENT
    return other is not None and len(other.lasers) > STRIPES_OF_A_PLANE and other.score > explained


def _why_no_stripe(images: Sequence[LaserImage]) -> NoBreakPoints:
    if all(image.lit.max() < VISIBLE_SHARE * image.threshold_scale_dn for image in images):
        return NoBreakPoints.IMAGE_DARK
    if all(np.median(image.lit) >= image.saturation_dn for image in images):
        return NoBreakPoints.IMAGE_SATURATED
    return NoBreakPoints.NO_STRIPE


def stripes_behind_camera(segments: Float64[Array, "segment column=12"], rig: Rig) -> bool:
    """Whether most straight stripes would lie behind the camera or inside its lens, for every possible laser.

    Of 81 rendered shots none of the columns of long segments does, in the same turned upside down a third or more.
    """
    long = segments[segments[:, CENTERS] >= LONG_COLUMNS]
    possible = _possible(long, rig)
    drawn = long[:, [LASER]] == np.arange(possible.shape[1])
    anywhere = (possible & (drawn | (long[:, [LASER]] == UNLABELLED))).any(axis=1)
    return 2.0 * float(long[anywhere, CENTERS].sum()) < float(long[:, CENTERS].sum())


def _possible(segments: Float64[Array, "segment column=12"], rig: Rig) -> Bool[Array, "segment laser"]:
    """For each segment and laser, whether part of the segment has a possible depth on the laser's light plane."""
    per_m = undistorted_rays(_ends_undistorted_px(segments), rig.camera) @ planes_per_m(rig).T
    # to infinity, with a margin for calibration and noise that is as large as the inverse of the range's upper limit
    return (per_m.max(axis=1) > -1.0 / FARTHEST_M) & (per_m.min(axis=1) < 1.0 / NEAREST_M)


def _ends_undistorted_px(segments: Float64[Array, "segment column=12"]) -> Float64[Array, "segment end=2 xy=2"]:
    """The ends of segments, in undistorted pixels."""
    x_px = segments[:, [X_START, X_END]]
    y_px = segments[:, [MIDDLE_Y]] + segments[:, [SLOPE]] * (x_px - segments[:, [MIDDLE_X]])
    ends_px: Float64[Array, "segment end=2 xy=2"] = np.stack([x_px, y_px], axis=-1)
    return ends_px


def predicted_bands(
    predicted: BreakPoints, lasers: Sequence[int], camera: Camera
) -> Int32[Array, "band side=4"] | None:
    """Search windows about the predicted stripes of some lasers, for `find_stripes`; None if none is predicted.

    Each window has a left and a right column, a top and a bottom row; right and bottom are exclusive.
    """
    pairs = [
        [arc.face_start_undistorted_px[laser].tolist(), arc.face_end_undistorted_px[laser].tolist()]
        for arc, laser in product(predicted.arcs, lasers)
    ]
    ends = [pair for pair in pairs if math.isfinite(sum(map(sum, pair)))]
    if not ends:
        return None
    shown = project(undistorted_rays(np.array(ends), camera), camera).tolist()
    bands = []
    for (x, y), (other_x, other_y) in shown:
        left, right = _search_range(x, other_x, BAND_PX + BEYOND_COLUMNS, camera.image_width)
        top, bottom = _search_range(y, other_y, BAND_PX, camera.image_height)
        bands.append((left, right, top, bottom))
    return np.array(bands, dtype=np.int32)


def _within_bands(stripes: Stripes, bands: Int32[Array, "band side=4"], camera: Camera) -> Stripes:
    """The stripes in search windows, without straight parts that go on beyond the left or right side of a window.

    Cut off there, a stripe on the body behind the ring would look like one on a face.
    """
    left, right = bands[:, 0] // BLOCK * BLOCK, -(-bands[:, 1] // BLOCK) * BLOCK  # as they are searched

    def searched(x: Float64[Array, "*shape"], y: Float64[Array, "*shape"]) -> Bool[Array, "*shape"]:
        row, column = y[..., None], x[..., None]
        of_band = (column >= left) & (column < right) & (row >= bands[:, 2]) & (row < bands[:, 3])
        inside: Bool[Array, "*shape"] = np.any(of_band, axis=-1) | (x < 0) | (x >= camera.image_width)
        return inside

    ends = project(undistorted_rays(_ends_undistorted_px(stripe_line_segments(stripes, camera)), camera), camera)
    goes_on = ~searched(ends[..., 0] + (MAX_GAP + 1) * np.array([-1.0, 1.0]), ends[..., 1])
    x, y = stripes.position_px.T
    dropped = np.zeros(len(x), dtype=bool)
    for (start_x, start_y), (end_x, end_y) in ends[goes_on.any(axis=1)].tolist():
        line_y = np.interp(x, [start_x, end_x], [start_y, end_y])
        dropped |= (x > start_x - 1.0) & (x < end_x + 1.0) & (np.abs(y - line_y) < SAME_STRIPE_PX)
    return stripes.without(dropped)


def _search_range(one: float, other: float, beyond: int, size: int) -> tuple[int, int]:
    """First and (exclusive) last index of the range between two coordinates, widened and clipped to the image."""
    first, last = (one, other) if one < other else (other, one)
    return min(max(int(first) - beyond, 0), size), min(max(int(last) + beyond + 1, 0), size)
