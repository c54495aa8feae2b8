"""Localization of the ring's edges in an image: their predicted places, the intensity step beside each, and tracking.

The ring's face has one intensity up to its edge, blurred by the optics; the intensity beyond is unknown and varies more
the farther it is from the edge. The position of the edge is the most likely one under this model, with sub-pixel
resolution across the edge. Of places beside a laser stripe no step is used. The ring's model (`geometry.ring`) predicts
the places; loops over them are compiled: kernels/edges/edge_places.c images them, kernels/edges/edge_steps.c takes the
profiles and finds the steps. The ring is fitted to the stripes and the steps, which extends the prediction, until the
edges leave the image or are lost.
"""

import math
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import NamedTuple

import cv2
import numpy as np

from ringpose.detect.stripes import FILTER_SIGMA_PX, RIDGE_REACH, lens
from ringpose.estimate.factors.edges import Edges, no_edges
from ringpose.estimate.factors.prior import Prior
from ringpose.estimate.measurements import Measurements, measurements_of
from ringpose.estimate.ring_estimate import DECISION_SIGMAS, estimate_ring, refine_ring
from ringpose.geometry.rays import rays_wrt_pixel_and_camera
from ringpose.geometry.ring import EDGE_SIGN, STEP, TINY, TURN, RingArcs, edge_distances, edge_points
from ringpose.kernels import _kernels, column_names, column_slices, kernel_record
from ringpose.kernels.lines import Lens
from ringpose.optics.feature_errors import BLUR_SIGMA_PX, POINT_SIGMA_PX, STEP_DN, STEP_SIGMAS, noise_across_edge
from ringpose.optics.image_noise import PIXEL_VARIANCE
from ringpose.types.arrays import Array, Bool, Float64, UInt, UInt8
from ringpose.types.detection import BreakPoints, JudgedRing
from ringpose.types.plausible import RING_RADIUS_M
from ringpose.types.rig import Camera, Rig

# The image and the places in it that laser stripes cover

ALONG_PX = 4
"""Length of edge over which a profile is averaged, and the spacing of the places: the intensity beyond the edge may
change within a few pixels. Also the size of the cells of the stripe mask."""

CELLS = math.ceil(RIDGE_REACH * FILTER_SIGMA_PX / ALONG_PX)
"""Places within so many cells of a stripe centre are excluded: as far as the light of a stripe is taken to reach."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class EdgeImage:
    """A frame in which the ring's edges are searched for."""

    image: UInt[Array, "row column"]
    saturation_dn: int
    lit: UInt8[Array, "cell_row cell_column"] | None = None
    """Stripe mask, not 0 in the cells beside a stripe; None for a frame without lasers."""


def stripe_mask(
    stripes_px: Float64[Array, "center xy=2"], image: UInt[Array, "row column"]
) -> UInt8[Array, "cell_row cell_column"]:
    """Mask of the image in cells of `ALONG_PX` pixels: 1 where a stripe centre is within `CELLS` cells, else 0."""
    lit = np.zeros((image.shape[0] // ALONG_PX + 1, image.shape[1] // ALONG_PX + 1), dtype=np.uint8)
    column, row = (stripes_px / ALONG_PX).astype(np.int64).T
    lit[row, column] = 1
    dilated: UInt8[Array, "cell_row cell_column"] = cv2.dilate(lit, np.ones((2 * CELLS + 1, 2 * CELLS + 1), np.uint8))
    return dilated


# Prediction of the edges in the image


HALF_TURN_RAD = math.pi
"""Largest angle on the ring to both sides of the origin: all of it may be in view. Half of it is the largest ratio of
such an arc to its chord."""

MAX_PLACES = 10**5
"""Largest number of places to each side of the origin."""


@kernel_record
@dataclass(frozen=True, slots=True, kw_only=True)
class PlaceParams:
    """Which predicted places on the edges are of use."""

    image_width: int
    image_height: int
    sigma_px: float = math.inf
    """Places with a larger predicted sigma across the edge are left out."""
    margin_px: float = 8.0
    """Places closer than this to the image border are left out."""
    wider: float = 0.3
    """Upper bound of the distortion at the image border, as a share of the image size."""
    nudge_m: float = 1e-4
    """Step off the face of the numerical derivative for metres per pixel."""


PLACE = column_slices("Place")
"""Columns of a place (edge_places.c)."""

PLACE_WIDTH = max(each.stop for each in PLACE.values())


@dataclass(frozen=True, slots=True, eq=False)
class EdgeTrace:
    """Places on the predicted edges that lie in the image: along the inner edge, then along the outer."""

    table: Float64[Array, "n column=13"]
    """Columns as returned by `edge_places`."""

    @property
    def point(self) -> Float64[Array, "n xyz=3"]:
        """Point on the ring's plane, in metres, camera frame."""
        return self.table[:, PLACE["point"]]

    @property
    def outward(self) -> Float64[Array, "n xyz=3"]:
        """Unit vector in the ring's plane that points off the face."""
        return self.table[:, PLACE["off_face"]]

    @property
    def edge_sign(self) -> Float64[Array, "n"]:
        """-1 on the inner edge, +1 on the outer."""
        return self.table[:, PLACE["sign"].start]

    @property
    def position_px(self) -> Float64[Array, "n xy=2"]:
        """Predicted position in the image."""
        return self.table[:, PLACE["position"]]

    @property
    def normal(self) -> Float64[Array, "n xy=2"]:
        """Unit normal of the edge in the image, off the face."""
        return self.table[:, PLACE["normal"]]

    @property
    def metres_per_px(self) -> Float64[Array, "n"]:
        """Metres on the ring's plane per pixel along the normal."""
        return self.table[:, PLACE["metres_per_px"].start]

    @property
    def number(self) -> Float64[Array, "n"]:
        """Index of the place along its edge, counted from the arcs' origin; places outside the image are skipped."""
        return self.table[:, PLACE["number"].start]

    def selected(self, which: Bool[Array, "n"]) -> "EdgeTrace":
        """The places for which `which` is true."""
        return EdgeTrace(self.table[which])


def edge_trace(
    arcs: RingArcs,
    covariance: Float64[Array, "step=7 step=7"] | None,
    camera: Camera,
    spacing_px: int | float,
    sigma_px: int | float = math.inf,
) -> EdgeTrace:
    """Places about `spacing_px` apart along both edges, where these are predicted with a sigma of at most `sigma_px`.

    The covariance is that of the ring's step; None for a ring that counts as known.
    """
    metres_per_px = float(arcs.origin[2]) / float(camera.camera_matrix[0, 0])
    count = _places_to_each_side(arcs, camera, spacing_px)
    if count < 0:
        return EdgeTrace(np.empty((0, PLACE_WIDTH)))
    number = np.tile(np.arange(-count, count + 1.0), 2)
    edge_sign = np.repeat(EDGE_SIGN, len(number) // 2)
    params = PlaceParams(image_width=camera.image_width, image_height=camera.image_height, sigma_px=float(sigma_px))
    return edge_places(arcs, number * (spacing_px * metres_per_px), edge_sign, number, lens(camera), params, covariance)


def _places_to_each_side(arcs: RingArcs, camera: Camera, spacing_px: int | float) -> int:
    """Upper bound of the places on one edge to one side of the arcs' origin; -1 if there are none."""
    x, y, z = arcs.origin.tolist()
    matrix, size = camera.camera_matrix, (camera.image_width, camera.image_height)
    if z <= 0.0:
        return -1
    at_px = x / z * matrix[0, 0] + matrix[0, 2], y / z * matrix[1, 1] + matrix[1, 2]
    corner_px = math.hypot(*(abs(at - side / 2) + side / 2 for at, side in zip(at_px, size, strict=True)))
    turn_rad = max(abs(arcs.curvature) * spacing_px * z / float(matrix[0, 0]), TINY)
    bound = min(HALF_TURN_RAD / 2 * corner_px / spacing_px, HALF_TURN_RAD / turn_rad, MAX_PLACES)
    return int(bound) if math.isfinite(bound) else -1


def edge_places(
    arcs: RingArcs,
    along_m: Float64[Array, "n"],
    edge_sign: Float64[Array, "n"],
    number: Float64[Array, "n"],
    lens: Lens,
    params: PlaceParams,
    covariance: Float64[Array, "step=7 step=7"] | None = None,
) -> EdgeTrace:
    """The places of edges at these distances along the face (`edge_points`) that lie in the image, with their numbers.

    The arcs are the same for all places, or one for each.
    """
    point, outward = edge_points(arcs, along_m, edge_sign)
    wrt_step = None if covariance is None else edge_distances(arcs, point, edge_sign).wrt_step.T
    off_face, normal = edge_sign[:, None] * outward, np.ascontiguousarray(np.atleast_2d(arcs.normal))
    places = _kernels.edge_places(point, off_face, edge_sign, number, normal, wrt_step, covariance, lens, params)
    return EdgeTrace(np.frombuffer(places, dtype=np.float64).reshape(-1, PLACE_WIDTH))


def outside_stripes(frame: EdgeImage, trace: EdgeTrace) -> EdgeTrace:
    """The places that are not beside a stripe."""
    if frame.lit is None:
        return trace
    column, row = (trace.position_px / ALONG_PX).astype(np.int64).T
    return trace.selected(frame.lit[row, column] == 0)


# Intensity profiles across the edge, and the step in each

BLUR_PX = 0.9
"""Blur (sigma) of edges that is assumed until it has been estimated."""

INSIDE_PX = 5
"""Samples inside the innermost candidate position, from which the intensity of the surface is estimated."""

OUTSIDE_PX = 3
"""Samples beyond the outermost candidate position."""

CLOSE_REACH_PX = 2
"""Half width of the search across an edge whose place is known: that of a candidate, or of the ring that is fitted."""

PLACES = 0.25
"""Spacing of the candidate positions in pixels; a parabola interpolates between them."""

NEIGHBOURS = 9
"""Number of neighbouring profiles, or steps, from whose scatter errors are estimated: 36 px, three facets of foil."""


@kernel_record
@dataclass(frozen=True, slots=True, kw_only=True)
class ProfileParams:
    """Parameters of the profiles.

    Samples are taken every pixel, from `reach_px` + `inside_px` inside the place to `reach_px` + `outside_px` beyond.
    """

    reach_px: int
    """Half width of the search for a step."""
    saturation_dn: int
    inside_px: int = INSIDE_PX
    outside_px: int = OUTSIDE_PX
    along_px: int = ALONG_PX
    noise_dn: float = math.sqrt(PIXEL_VARIANCE)
    """Minimum noise of a grey value: quantization."""
    pooled: int = NEIGHBOURS


@kernel_record
@dataclass(frozen=True, slots=True, kw_only=True)
class StepParams:
    """Parameters of the step fit in a profile."""

    flat: float = TINY
    """Smallest second difference of the cost at a minimum."""
    touched_px: float = float(OUTSIDE_PX)
    """A profile with a saturated sample closer than this to the step is rejected: it hides the intensity beyond."""
    spacing_px: float = PLACES
    """Distance between the step positions that are tried."""
    pooled: int = NEIGHBOURS
    """Neighbouring profiles over which the residual variance is averaged."""


class Templates(NamedTuple):
    """Step templates, which do not depend on the image, for each position of the step."""

    across_px: Float64[Array, "sample"]
    place_px: Float64[Array, "place"]
    table: Float64[Array, "part=3 sample place"]
    """Weight; constant part, orthonormal to the step under the weights; step."""
    unit: Float64[Array, "place"]
    """Coefficient of the step part for a step of height 1."""


class Profiles(NamedTuple):
    """Intensity across predicted places of an edge, from the surface outward."""

    value: Float64[Array, "n sample"]
    """Above the surface's level, in units of its noise."""
    saturated: Bool[Array, "n sample"]
    noise_dn: Float64[Array, "n"]


class EdgeSteps(NamedTuple):
    """The step found near each predicted place."""

    offset_px: Float64[Array, "n"]
    """Along the normal, from the predicted place; NaN where there is no step."""
    sigma_px: Float64[Array, "n"]
    height: Float64[Array, "n"]
    """Height of the step in its own standard deviations."""
    height_dn: Float64[Array, "n"]
    cost: Float64[Array, "n"]
    """Residual sum of squares, in units of the noise."""


STEP_COLUMNS = column_names("EdgeStep")
"""Columns of a step (edge_steps.c): the fields of `EdgeSteps`."""


def edge_profiles(
    image: UInt[Array, "row column"],
    position_px: Float64[Array, "n xy=2"],
    normal: Float64[Array, "n xy=2"],
    reach_px: int,
    saturation_dn: int,
) -> Profiles:
    """Mean intensity across each predicted place, over `ALONG_PX` of edge; the normals point off the surface.

    Grey values are interpolated bilinearly; a sample is saturated if one of the averaged values is.
    """
    params = ProfileParams(reach_px=reach_px, saturation_dn=saturation_dn)
    value = np.empty((len(position_px), 2 * reach_px + INSIDE_PX + OUTSIDE_PX + 1))
    saturated, noise = np.empty(value.shape, dtype=np.bool_), np.empty(len(value))
    image, position_px, normal = (np.ascontiguousarray(each) for each in (image, position_px, normal))
    _kernels.edge_profiles(image, position_px, normal, params, value, saturated, noise)
    return Profiles(value, saturated, noise)


def edge_steps(profiles: Profiles, reach_px: int, blur_px: float) -> EdgeSteps:
    """The most likely position of a step of this blur (sigma) in each profile, within `reach_px` of the prediction."""
    params, templates = StepParams(), _templates(reach_px, blur_px)
    value, saturated, noise_dn = (np.ascontiguousarray(each) for each in profiles)
    steps = _kernels.edge_steps(
        value, saturated, noise_dn, templates.across_px, templates.place_px, templates.unit, templates.table, params
    )
    columns = np.frombuffer(steps, dtype=np.float64).reshape(-1, len(STEP_COLUMNS)).T
    return EdgeSteps(**dict(zip(STEP_COLUMNS, columns, strict=True)))


@lru_cache(maxsize=256)
def _templates(reach_px: int, blur_px: float) -> Templates:
    """The model of a profile for each candidate position: two blurred levels, orthonormal under the weights."""
    across = np.arange(-reach_px - INSIDE_PX, reach_px + OUTSIDE_PX + 1, dtype=np.float64)
    position = np.arange(-reach_px, reach_px + PLACES / 2, PLACES)
    beyond = across - position[:, None]
    grid, index = np.unique(beyond, return_inverse=True)
    blurred = np.array([0.5 * math.erfc(-u / (blur_px * math.sqrt(2))) for u in grid.tolist()])
    step = blurred[index].reshape(beyond.shape)
    sigma = noise_across_edge(beyond)
    orthonormal, triangle = np.linalg.qr(np.stack([np.ones_like(step), step], axis=-1) / sigma[..., None])
    basis = orthonormal / sigma[..., None]
    return Templates(
        across_px=across,
        place_px=position,
        table=np.ascontiguousarray(np.stack([sigma.T**-2.0, basis[..., 0].T, basis[..., 1].T])),
        unit=np.abs(triangle[:, 1, 1]),
    )


BLUR_SPANS = (0.4, 0.2, 0.07)
"""Half widths, in the logarithm, of the successive parabolas by which the blur is estimated."""

BLUR_STEPS = 60
"""Number of the steps of highest contrast from which the blur is estimated."""


def estimated_blur_px(profiles: Profiles, reach_px: int) -> float:
    """The blur (sigma) with the least median residual over the steps of highest contrast.

    The position of a step depends on the assumed blur by a third of the blur's error.
    """
    clear = np.flatnonzero(~profiles.saturated.any(axis=1))
    clear = clear[np.argsort(np.ptp(profiles.value[clear], axis=1))[-BLUR_STEPS:]]
    if len(clear) < BLUR_STEPS // 4:
        return BLUR_PX
    part = Profiles(*(each[clear] for each in profiles))
    log_blur = math.log(BLUR_PX)
    for span in BLUR_SPANS:  # minimum of the parabola through three trials
        trials = [round(math.exp(log_blur + side * span), 2) for side in (-1, 0, 1)]
        left, middle, right = (_median(edge_steps(part, reach_px, trial).cost) for trial in trials)
        curvature = left - 2 * middle + right
        step = (left - right) / (2 * curvature) if curvature > 0 else math.copysign(1.0, left - right)
        log_blur += span * min(max(step, -1.5), 1.5)
    return round(math.exp(log_blur), 2)


def _median(values: Float64[Array, "n"]) -> float:
    """The median; `np.median` takes ten times as long for so few values."""
    ascending = np.sort(values)
    return float(ascending[(len(values) - 1) // 2] + ascending[len(values) // 2]) / 2


# Steps as observations of the ring

CLUTTER = 2.5
"""Factor on the sigmas of single steps: the intensity beyond the edge is not uniform."""


class ClearSteps(NamedTuple):
    """Places of a trace at which an edge of the ring may have been found, and the steps there."""

    trace: EdgeTrace
    steps: EdgeSteps


def clear_steps(frame: EdgeImage, trace: EdgeTrace, reach_px: int, *, precise: bool = False) -> ClearSteps:
    """The steps within `reach_px` of the places of a trace that stand out of the noise.

    The steps are located for an estimated blur if `precise`, else for a blur of `BLUR_PX`, which takes less time.
    """
    profiles = edge_profiles(frame.image, trace.position_px, trace.normal, reach_px, frame.saturation_dn)
    blur_px = estimated_blur_px(profiles, reach_px) if precise else BLUR_PX
    steps = edge_steps(profiles, reach_px, blur_px)
    clear = np.isfinite(steps.offset_px) & (steps.sigma_px < POINT_SIGMA_PX)
    clear &= (steps.height > STEP_SIGMAS) & (steps.height_dn > STEP_DN)
    return ClearSteps(trace.selected(clear), EdgeSteps(*(each[clear] for each in steps)))


def edge_observations(clear: ClearSteps, rig: Rig) -> Edges:
    """The steps as measurements of the ring's edges, without common errors of their own.

    A camera without covariance counts as exact in this search.
    """
    trace, steps = clear
    sigma_px = CLUTTER * np.hypot(steps.sigma_px, BLUR_SIGMA_PX)
    point = rays_beside(trace, steps.offset_px)
    ray = point / point[:, 2:]
    wrt_camera = np.zeros((len(ray), 2, 4 + len(rig.camera.distortion_coefficients)))
    if rig.covariance is not None:
        _, wrt_camera = rays_wrt_pixel_and_camera(ray[:, :2], rig.camera)
    step_m = (sigma_px * trace.metres_per_px)[:, None] * trace.outward
    return Edges(
        edge=(trace.edge_sign > 0).astype(np.int64),
        ray=ray,
        step=(step_m[:, :2] - ray[:, :2] * step_m[:, 2:]) / point[:, 2:],
        wrt_camera=wrt_camera,
        common=np.empty((len(ray), 0)),
        stamp_s=np.full(len(ray), np.nan),
    )


def rays_beside(trace: EdgeTrace, offset_px: Float64[Array, "n"]) -> Float64[Array, "n xyz=3"]:
    """Rays (camera frame) through the points at these offsets from the places of a trace, along the edge normals."""
    ray: Float64[Array, "n xyz=3"] = trace.point + (offset_px * trace.metres_per_px)[:, None] * trace.outward
    return ray


class PredictedRing(NamedTuple):
    """A predicted ring, and the covariance of its increments (`STEP` of `ringpose.geometry.ring`)."""

    arcs: RingArcs
    covariance: Float64[Array, "step=7 step=7"]


# Tracking of the edges from the stripes, by the ring that is fitted to both

FARTHER = 1.05
"""Minimum growth of the number of places in a round; tracking stops with less."""


def tracked_ring(stripes: "RingFromStripes", frame: EdgeImage, rig: Rig) -> PredictedRing | None:
    """The ring with its edges as far as they can be tracked from the stripes; None if they cannot."""
    ring: PredictedRing | None = stripes.start
    if len(stripes.measured.lasers) == 1:
        turned, beside = edges_beside_stripe(stripes, frame, rig)
        ring = stripes.fitted(turned, beside)
    tracked = 0
    while ring is not None and plausible(ring.arcs):
        trace = edge_trace(*ring, rig.camera, ALONG_PX, CLOSE_REACH_PX)
        if len(trace.edge_sign) <= FARTHER * tracked:
            return ring
        tracked = len(trace.edge_sign)
        steps = clear_steps(frame, outside_stripes(frame, trace), CLOSE_REACH_PX)
        ring = stripes.fitted(ring.arcs, edge_observations(steps, rig)) if len(steps.trace.edge_sign) else None
    return None


# Direction of the edges at a single stripe, which its two ends leave open

TURNS_RAD = np.linspace(-1.2, 1.2, 81)
"""Candidate angles between the stripe's normal on the face and the edges; of a stripe across both arcs, whose four ends
leave nothing else of the ring open, between the face's middle and its centre."""

MIN_OF_BOTH = 8
"""Minimum number of places that show a step in a direction, or of points on either edge of a ring that nothing else
confirms."""

DISTINCT, SIMILAR = 2, 6
"""Minimum ratio of the number of places with a step to that of any direction that is not among the next `SIMILAR`
ones."""


def edges_beside_stripe(stripes: "RingFromStripes", frame: EdgeImage, rig: Rig) -> tuple[RingArcs, Edges]:
    """Ring and steps along its two edges, of the directions at the stripe's ends that the image supports best.

    The ring of the stripes and no steps if it supports none.
    """
    arcs, whole = stripes.start.arcs, stripes.shows_both_arcs
    if whole:
        turned = [_aside(arcs, math.tan(turn_rad) * arcs.mean_radius_m) for turn_rad in TURNS_RAD.tolist()]
    else:
        turned = [_turned(arcs, turn_rad) for turn_rad in TURNS_RAD.tolist()]
    places = np.delete(np.arange(-NEIGHBOURS, NEIGHBOURS + 1.0), NEIGHBOURS)  # so near the stripe edges are straight
    spacing_m = ALONG_PX * float(arcs.origin[2]) / float(rig.camera.camera_matrix[0, 0])
    params = PlaceParams(image_width=rig.camera.image_width, image_height=rig.camera.image_height)
    tables = []
    for direction, ring in enumerate(turned):
        middles_m = [0.0, _along_to(arcs.origin + 2.0 * (arcs.center - arcs.origin), ring)] if whole else [0.0]
        along_m, edge_sign = map(np.ravel, np.meshgrid(np.add.outer(middles_m, spacing_m * places), EDGE_SIGN))
        label = np.full(len(along_m), float(direction))
        tables.append(edge_places(ring, along_m, edge_sign, label, lens(rig.camera), params).table)
    trace = outside_stripes(frame, EdgeTrace(np.concatenate(tables)))  # its `number` is the candidate direction

    clear = clear_steps(frame, trace, CLOSE_REACH_PX)
    count = np.bincount(clear.trace.number.astype(np.int64), minlength=len(turned))
    best = int(np.argmax(count))
    elsewhere = np.delete(count, slice(max(best - SIMILAR, 0), best + SIMILAR + 1))
    if count[best] < max(MIN_OF_BOTH, DISTINCT * elsewhere.max()):
        return arcs, no_edges(rig.camera)
    steps = clear_steps(frame, trace.selected(trace.number == best), CLOSE_REACH_PX)
    return turned[best], edge_observations(steps, rig)


def _along_to(point_m: Float64[Array, "xyz=3"], arcs: RingArcs) -> float:
    """Distance along the middle of the face from the arcs' origin to the direction of a point."""
    inward, along, _ = (arcs.axes @ (point_m - arcs.center)).tolist()
    return math.atan2(along, -inward) * arcs.mean_radius_m


def _turned(arcs: RingArcs, turn_rad: float) -> RingArcs:
    """The ring whose edges pass through the ends of a stripe at another angle: the face is as much narrower."""
    turned = arcs.retract(turn_rad * np.eye(len(STEP))[TURN])
    return replace(turned, half_band_m=math.cos(turn_rad) * arcs.half_band_m)


def _aside(arcs: RingArcs, aside_m: float) -> RingArcs:
    """The ring through the four ends of a stripe whose line passes this far beside its centre, not through it."""
    inner_m, outer_m = np.hypot(arcs.radius_m, aside_m).tolist()
    center, mean_m = arcs.center + aside_m * arcs.axes[1], 0.5 * (inner_m + outer_m)
    inward = (center - arcs.origin) / np.linalg.norm(center - arcs.origin)
    return RingArcs(
        origin=center - mean_m * inward,
        axes=np.array([inward, np.cross(arcs.normal, inward), arcs.normal]),
        curvature=1.0 / mean_m,
        half_band_m=0.5 * (outer_m - inner_m),
    )


# Fit of the ring to stripes and tracked edge points

ITERATIONS = 2
"""Gauss-Newton iterations of each fit."""

LINE_SIGMA_PX = 0.1
"""Calibration error that is added to the sigma of a stripe's line, across the line."""

END_SIGMA_PX = 0.4
"""Error of calibration and material that is added to the sigma of a break point."""

POSSIBLE = ((0.03, 5.0), (0.0, RING_RADIUS_M.highest), (0.1, 1.1), (-1.0, 1.0 / RING_RADIUS_M.lowest))
"""Limits of depth and half band in metres, of the cosine between normal and optical axis, of |curvature| in 1/m."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RingFromStripes:
    """The measurements of the stripes, and the ring by them alone."""

    measured: Measurements
    start: PredictedRing

    @property
    def shows_both_arcs(self) -> bool:
        """Whether there are break points on both arcs."""
        return not bool(self.measured.points.described.all())

    def fitted(self, arcs: RingArcs, edges: Edges) -> PredictedRing | None:
        """The ring near `arcs` by stripes and edge points; weak priors hold what these leave open.

        Beside several stripes the edges count as those of the face, to be searched farther along it.
        """
        prior = Prior(regularize_about=self.start.arcs)
        edges = replace(edges, walls=len(self.measured.lines.laser) == 1)
        with np.errstate(all="ignore"):
            ring = refine_ring(replace(self.measured, edges=edges), prior, arcs, ITERATIONS)
        return None if ring is None else PredictedRing(*ring)


@lru_cache(maxsize=1)  # the frames of a shot share it, unless the ring moves between them
def ring_from_stripes(break_points: BreakPoints, rig: Rig, judged: JudgedRing | None = None) -> RingFromStripes | None:
    """The ring by the stripes alone; None without a stripe's line on the face and one end on each edge.

    `judged`: the ring by which the break points were judged, from which the iteration starts.
    """
    variance = break_points.covariance_px2[..., 0, 0] + END_SIGMA_PX**2
    # two uncertain ends still predict the edges; the steps found there then confirm or contradict them
    inflated = np.minimum(variance, CLOSE_REACH_PX**2)[..., None, None] * np.eye(2)
    allowed = replace(
        break_points, covariance_px2=inflated, face_sigma_px=np.hypot(break_points.face_sigma_px, LINE_SIGMA_PX)
    )
    measured = measurements_of(allowed, rig)
    if not len(measured.lines.laser) or len(set(measured.points.edge.tolist())) < len(EDGE_SIGN):
        return None
    estimate = estimate_ring(measured, Prior(), judged, tolerance_sigmas=DECISION_SIGMAS)
    if estimate is None or not plausible(estimate.arcs):
        return None
    return RingFromStripes(measured=measured, start=PredictedRing(estimate.arcs, estimate.inverse))


def plausible(arcs: RingArcs) -> bool:
    """Whether the arcs are within `POSSIBLE`, the range of rings in front of a camera.

    A fit to contradictory observations may not be.
    """
    numbers = [arcs.origin[2], arcs.half_band_m, -arcs.axes[2, 2], abs(arcs.curvature)]
    return all(low < number < high for number, (low, high) in zip(numbers, POSSIBLE, strict=True))
