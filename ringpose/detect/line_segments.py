"""The paper's line segment detector, and stripes from its segments (ringpose-method(7), section 2).

The loops are compiled, in kernels/segments: gradient.c (gradient and anchors), chains.c (edge chains and their straight
pieces) and segments.c (line fits and collinear lines).

Gradient and anchors -> edge chains, continuous and one pixel wide -> straight pieces -> line segments. A stripe is the
bright region between two parallel segments.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ringpose.detect.difference_images import LaserImage, brightest_image
from ringpose.detect.stripes import MIN_COLUMNS
from ringpose.kernels import _kernels
from ringpose.types.arrays import Array, Bool, Float64, Int16, Int32, Int64, UInt, UInt8, UInt16
from ringpose.types.detection import UNLABELLED, BreakPoints, Detection, NoBreakPoints, Segments, Stripes
from ringpose.types.image import Shot, full_scale_dn
from ringpose.types.options import SegmentMethod


@dataclass(frozen=True, slots=True, kw_only=True)
class SegmentParameters:
    """Thresholds of the line detector, for 8-bit images.

    The paper does not give any. These are in the flat maximum of the recall on the York Urban photographs and on
    synthetic laser stripes (peaks of 38 and 170 grey values, speckle): changes by a quarter change it by 0.01 to 0.02.
    """

    upper_gradient_dn: float = 4.0
    """Minimum gradient of an anchor, in grey values per pixel of the smoothed image."""
    lower_gradient_dn: float = 2.0
    """Minimum gradient of an edge pixel. In clutter, thresholds of 3.0 and 1.5 take a fifth more time and increase the
    recall on the York Urban photographs by 0.02; on stripes they make no difference."""
    shortest_px: int = 12
    """Minimum length of chains in pixels, and minimum support of segments."""
    deviation_px: float = 1.0
    """Maximum excess of a piece's estimated length over its chord; the cut is at its farthest pixel."""
    share_change: float = 0.7
    """Maximum change of the direction shares within a piece (sum over the three; 2 is a right angle); digitisation
    alone changes the shares of a straight line by up to 2 / `window_steps`."""
    window_steps: int = 8
    """Number of steps over which the shares are computed; the cut is half of them before the end."""
    shortest_joined_px: int = 6
    """Minimum length of straight pieces that may become part of a refined segment: speckle breaks an edge into short
    ones, and a limit of 12 pixels would lose 0.02 of the length recalled on the York Urban photographs."""
    gap_px: float = 8.0
    """Maximum gap between joined lines; a laser's shadow at the edge of a ring is wider."""
    aside_px: float = 1.5
    """Maximum distance of the ends from the joined line. Speckle moves edges by a pixel: 1.0 leaves twice as many
    fragments of a stripe as 1.5."""


def find_segments(
    image: UInt[Array, "row column"],
    parameters: SegmentParameters = SegmentParameters(),
    method: SegmentMethod = SegmentMethod.REFINED,
    saturation_dn: int | None = None,
) -> Segments:
    """Straight edges of the image; thresholds refer to grey values of 8 bits, whatever the depth of the image.

    The depth follows from the saturation value. By default this is estimated from the image, where a dim image may be
    attributed a smaller bit depth.
    """
    narrowed, bits = in_sixteen_bits(image, saturation_dn)
    gradient = image_gradient(narrowed, parameters.upper_gradient_dn, bits)
    chains = edge_chains(gradient, parameters.lower_gradient_dn, parameters.shortest_px)
    return chords(chains, parameters) if method is SegmentMethod.LENGTH else refined(gradient, chains, parameters)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Chains:
    """Pixels of all chains, concatenated."""

    pixels: Int32[Array, "pixel xy=2"]
    starts: Int32[Array, "start"]
    """Chain i is `pixels[starts[i]:starts[i + 1]]`."""


def chords(chains: Chains, parameters: SegmentParameters) -> Segments:
    """Each straight piece as the line from its first to its last pixel, which is within a pixel of the edge."""
    pieces = straight_pieces(chains, parameters, parameters.shortest_px)
    ends_px = chains.pixels[pieces].astype(np.float64)
    support = (pieces[:, 1] - pieces[:, 0] + 1).astype(np.int64)
    return Segments(start_px=ends_px[:, 0], end_px=ends_px[:, 1], support=support)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Gradient:
    """Gradient magnitude and its maxima across the edge."""

    magnitude: Int16[Array, "row column"]
    """Gradient in 1 / `STEPS_PER_DN` grey value per pixel."""
    anchors: Int32[Array, "anchor"]
    """Pixels as `row * width + column`, ascending."""
    orientation: UInt8[Array, "anchor"]
    """0: edge along x, 1: down to the right, 2: along y, 3: down to the left."""


def refined(gradient: Gradient, chains: Chains, parameters: SegmentParameters) -> Segments:
    """Least-squares lines through the sub-pixel positions of straight pieces; collinear ones joined."""
    pieces = straight_pieces(chains, parameters, parameters.shortest_joined_px)
    lines_px, moments = fitted_lines(gradient.magnitude, chains.pixels, pieces, parameters.window_steps // 2)
    ends_px, support = joined_lines(
        lines_px, moments, pieces, parameters.gap_px, parameters.aside_px, parameters.shortest_px
    )
    return Segments(start_px=ends_px[:, 0], end_px=ends_px[:, 1], support=support)


def straight_pieces(chains: Chains, parameters: SegmentParameters, shortest_px: int) -> Int32[Array, "piece end=2"]:
    """First and last pixel of each straight piece of `shortest_px` or more; neighbours share the corner.

    Pieces are cut by the length condition and the direction shares (ringpose-method(7), section 2).
    """
    pieces = _kernels.cuts(
        chains.pixels,
        chains.starts,
        parameters.deviation_px,
        parameters.share_change,
        parameters.window_steps,
        shortest_px,
    )
    return np.frombuffer(pieces, np.int32).reshape(-1, 2)


def fitted_lines(
    magnitude: Int16[Array, "row column"],
    pixels: Int32[Array, "pixel xy=2"],
    pieces: Int32[Array, "piece end=2"],
    trim_px: int,
) -> tuple[Float64[Array, "piece end=2 xy=2"], Float64[Array, "piece moment=6"]]:
    """Ends of the least-squares line through the sub-pixel maxima of the magnitude along each piece, and its moments.

    A maximum is the vertex of the parabola through three magnitudes across the piece's longer side, down a column or
    along a row. `trim_px` pixels at both ends, but never more than a quarter of the piece, are rounded corners and
    stay out. The line ends at the end pixels of the piece, projected along its longer side; with fewer than two maxima
    it is the chord. The moments are the sums over the maxima of 1, x, y, x x, x y and y y.
    """
    lines, moments = _kernels.fits(magnitude, pixels, pieces, trim_px)
    return np.frombuffer(lines).reshape(-1, 2, 2), np.frombuffer(moments).reshape(-1, 6)


def joined_lines(
    lines: Float64[Array, "piece end=2 xy=2"],
    moments: Float64[Array, "piece moment=6"],
    pieces: Int32[Array, "piece end=2"],
    gap_px: float,
    aside_px: float,
    shortest_px: int,
) -> tuple[Float64[Array, "line end=2 xy=2"], Int64[Array, "line"]]:
    """Lines after joining those that continue each other, and the number of supporting pixels of each.

    Each line of at least `shortest_px` pixels, from the first to the last, is joined to the nearest line beyond its
    end, at most `gap_px` ahead and 2 `aside_px` beside or behind. The search is repeated from the new end, then beyond
    the start. Two lines are joined only if all ends of both lie within `aside_px` (measured along x or y) of the
    least-squares line through the maxima of both. Shorter lines that were not joined to another are dropped.
    """
    flat = np.ascontiguousarray(lines).reshape(-1, 4)
    joined, support = _kernels.joins(flat, moments, pieces, gap_px, aside_px, shortest_px)
    return np.frombuffer(joined).reshape(-1, 2, 2), np.frombuffer(support, np.int64)


def edge_chains(gradient: Gradient, lower_dn: float, shortest: int) -> Chains:
    """Edge chains, one pixel wide, along which the gradient is at least `lower_dn` grey values per pixel.

    From each anchor, the strongest first, two walks start in opposite directions. A walk continues to the largest
    magnitude of the three pixels ahead (straight on, if equal; then left). It stops below `lower_dn`, on another chain,
    or where one of the three is among the image's outermost three pixels; anchors must not lie there. Chains of fewer
    than `shortest` pixels are dropped, but no other chain may cross them.

    The magnitude serves as scratch memory and is restored on return: no other thread may use it in the meantime.
    """
    pixels, starts = _kernels.chains(
        gradient.magnitude, gradient.anchors, gradient.orientation, magnitude_steps(lower_dn), shortest
    )
    return Chains(pixels=np.frombuffer(pixels, np.int32).reshape(-1, 2), starts=np.frombuffer(starts, np.int32))


STEPS_PER_DN = _kernels.STEPS_PER_DN
"""Units of the kernels' magnitude in one grey value per pixel: 16 of the smoothing, 8 of the Sobel weights."""

MAX_STEPS = np.iinfo(np.int16).max
"""Upper limit, above any gradient of an 8-bit image."""


def image_gradient(
    image: UInt8[Array, "row column"] | UInt16[Array, "row column"], upper_dn: float, bits: int = 8
) -> Gradient:
    """Gradient of the smoothed image, and its anchors: local maxima of at least `upper_dn` grey values per pixel.

    The image is smoothed with the binomial 1 4 6 4 1 (sigma 1 px); then Sobel. The magnitude is max + 3/8 min of the
    two absolute components (7 % from the Euclidean one). It is 0 on the outermost three pixels, whose gradient needs
    pixels outside the image: extrapolation would bend the edges there. Anchors are maxima along the row in every eighth
    row, if the edge is nearer to upright, else down the column in every eighth column.
    Images of 16-bit elements have values of `bits` bits, 9 to 16, which are scaled to 8 bits: the last four of 12 are a
    fraction.
    """
    magnitude = np.empty(image.shape, np.int16)
    anchors, orientation = _kernels.gradient(np.ascontiguousarray(image), bits, magnitude_steps(upper_dn), magnitude)
    return Gradient(
        magnitude=magnitude,
        anchors=np.frombuffer(anchors, np.int32),
        orientation=np.frombuffer(orientation, np.uint8),
    )


def magnitude_steps(gradient_dn: float) -> int:
    """Grey values per pixel in the kernels' unit: 1 to `MAX_STEPS`."""
    return round(min(max(1.0, STEPS_PER_DN * gradient_dn), MAX_STEPS))


def in_sixteen_bits(
    image: UInt[Array, "row column"], saturation_dn: int | None = None
) -> tuple[UInt8[Array, "row column"] | UInt16[Array, "row column"], int]:
    """The image in elements of 8 or 16 bits, and the bit depth of its values; low bits of wider images are dropped.

    `saturation_dn` is the grey value at which a pixel saturates; by default it is estimated from the image.
    """
    if image.dtype == np.uint8:
        return image, 8
    if saturation_dn is None:
        saturation_dn = full_scale_dn(image) if image.dtype == np.uint16 else 0
    bits = max(saturation_dn, int(image.max(initial=0))).bit_length()
    if bits <= np.iinfo(np.uint8).bits:
        return image.astype(np.uint8), 8
    if bits <= np.iinfo(np.uint16).bits:
        return image.astype(np.uint16, copy=False), bits
    return (image >> (bits - 16)).astype(np.uint16), 16


def eight_bit(image: UInt[Array, "row column"]) -> UInt8[Array, "row column"]:
    """The image in 8 bits; low bits are dropped until the largest value fits, which preserves the contrast."""
    if image.dtype == np.uint8:
        return image
    excess = max(0, int(image.max(initial=0)).bit_length() - 8)
    return (image >> excess).astype(np.uint8)


def segments_only(shot: Shot, method: SegmentMethod = SegmentMethod.REFINED) -> Detection:
    """The line segments in the frame with the most lasers on, without a search for break points."""
    return Detection(
        shot=shot.name,
        stamp_s=shot.measured_at_s,
        break_points=NoBreakPoints.NOT_SOUGHT,
        segments=find_segments(brightest_image(shot), method=method, saturation_dn=shot.saturation_dn),
    )


PIXEL_END_SIGMA_PX = 1.0
"""Standard deviation, in each direction, that is stated for the pixel ends of chords; the paper states none."""


def with_pixel_ends(points: BreakPoints, images: Sequence[LaserImage]) -> BreakPoints:
    """The break points as the paper's detector gives them: the middle between the end pixels of a stripe's two edges.

    The edges are the chords (length condition, whole pixels) beside the stripe on the ring's face, which is known
    already: which of all segments are those of the face the paper does not say. An edge that is broken by speckle ends
    where the outermost of its chords ends. NaN where a side has no edge.
    """
    position_px = np.full_like(points.position_px, np.nan)
    for image in images:
        signal = image.lit if image.dark is None else np.where(image.lit > image.dark, image.lit - image.dark, 0)
        chords_px = find_segments(
            signal.astype(image.lit.dtype), method=SegmentMethod.LENGTH, saturation_dn=image.threshold_scale_dn
        )
        for laser in image.lasers:
            position_px[laser] = _pixel_ends(chords_px, points.position_px[laser])
    opposite = None if points.opposite is None else with_pixel_ends(points.opposite, images)
    seen = np.isfinite(position_px[..., :1, None])
    covariance_px2 = np.where(seen, PIXEL_END_SIGMA_PX**2 * np.eye(2), np.nan)
    return replace(points, position_px=position_px, covariance_px2=covariance_px2, repeated=None, opposite=opposite)


def _pixel_ends(segments: Segments, ends_px: Float64[Array, "edge=2 xy=2"]) -> Float64[Array, "edge=2 xy=2"]:
    """The ends of a stripe by the chords along it; NaN unless there are chords on both sides and ends to look near."""
    order = np.argsort(ends_px[:, 0])
    (left, first), (right, last) = ends_px[order].tolist()
    found = np.full((2, 2), np.nan)
    if not np.isfinite(ends_px).all() or right - left < MIN_COLUMNS:
        return found
    from_left = np.where(
        (segments.start_px[:, 0] <= segments.end_px[:, 0])[:, None], segments.start_px, segments.end_px
    )
    to_right = segments.start_px + segments.end_px - from_left
    slope, reach = (last - first) / (right - left), WIDTH_PX[1] / 2
    over = np.minimum(to_right[:, 0], right) - np.maximum(from_left[:, 0], left)
    off_px = [each[:, 1] - first - slope * (each[:, 0] - left) for each in (from_left, to_right)]
    along = (over >= MIN_COLUMNS - 1) & (np.maximum(np.abs(off_px[0]), np.abs(off_px[1])) < reach)
    sides = [along & (side * (off_px[0] + off_px[1]) > 0) for side in (-1, 1)]
    if all(side.any() for side in sides):
        outermost = [
            [each[side][getattr(each[side][:, 0], extreme)()] for side in sides]
            for each, extreme in ((from_left, "argmin"), (to_right, "argmax"))
        ]
        found[order] = np.mean(outermost, axis=1)
    return found


WIDTH_PX = (1.5, 14.0)
"""Range of the distance between the two edges of a stripe."""

PARALLEL = 0.12
"""Maximum difference of the edges' slopes."""

CONTRAST_DN = 4.0
"""Minimum difference of the brightness between the edges and outside them."""

MIDDLE_SIGMA_PX = 0.25
"""Assumed standard deviation of the middle between two refined lines: 0.003 px without, 0.2 px with speckle."""


def stripes_between_segments(
    image: UInt[Array, "row column"], dark: UInt[Array, "row column"] | None = None
) -> tuple[Stripes, Segments]:
    """Stripe centres, one a column, midway between the segments of a stripe's two edges, and the segments.

    Refined segments are used, with errors of 0.1 px. The paper's chords end on whole pixels: the middle between two had
    errors of up to 1.5 px, and in one shot of four its slope was too wrong for a ring to be found.
    """
    signal = image if dark is None else np.where(image > dark, image - dark, 0).astype(image.dtype)
    segments = find_segments(signal, method=SegmentMethod.REFINED)
    upper, lower, first, last = _edge_pairs(segments)
    bright = _contrast(signal, segments, (upper, lower), (first, last)) > CONTRAST_DN
    upper, lower, first, last = upper[bright], lower[bright], first[bright], last[bright]

    columns = [np.arange(a, b + 1, dtype=np.float64) for a, b in zip(first, last, strict=True)]
    piece = np.repeat(np.arange(len(columns)), [len(each) for each in columns])
    x = np.concatenate(columns) if columns else np.zeros(0)
    center = (_ordinate(segments, upper[piece], x) + _ordinate(segments, lower[piece], x)) / 2
    row = np.clip(np.rint(center).astype(np.int64), 0, image.shape[0] - 1)
    stripes = Stripes(
        position_px=np.stack([x, center], axis=-1),
        sigma_px=np.full(len(x), MIDDLE_SIGMA_PX),
        peak_dn=signal[row, x.astype(np.int64)].astype(np.float64),
        piece=piece.astype(np.int64),
        laser=np.full(len(columns), UNLABELLED, dtype=np.int64),
    )
    return stripes, segments


def _edge_pairs(
    segments: Segments,
) -> tuple[Int64[Array, "pair"], Int64[Array, "pair"], Int64[Array, "pair"], Int64[Array, "pair"]]:
    """Upper and lower segment of each possible stripe, with the first and last column of their overlap."""
    left = np.minimum(segments.start_px[:, 0], segments.end_px[:, 0])
    right = np.maximum(segments.start_px[:, 0], segments.end_px[:, 0])
    lying = np.flatnonzero(right - left >= MIN_COLUMNS - 1)
    upper, lower = (each.ravel() for each in np.meshgrid(lying, lying, indexing="ij"))
    first = np.maximum(left[upper], left[lower])
    last = np.minimum(right[upper], right[lower])
    slope = _slope(segments)
    middle = (first + last) / 2
    width = _ordinate(segments, lower, middle) - _ordinate(segments, upper, middle)
    fits: Bool[Array, "pair"] = (last - first >= MIN_COLUMNS - 1) & (width > WIDTH_PX[0]) & (width < WIDTH_PX[1])
    fits &= np.abs(slope[upper] - slope[lower]) < PARALLEL
    return upper[fits], lower[fits], first[fits].astype(np.int64), last[fits].astype(np.int64)


def _slope(segments: Segments) -> Float64[Array, "segment"]:
    """Slope in rows per column; zero for vertical segments, which are not edges of stripes."""
    run, rise = (segments.end_px - segments.start_px).T
    return np.where(run == 0, 0.0, rise / np.where(run == 0, 1.0, run))


def _ordinate(segments: Segments, which: Int64[Array, "n"], x: Float64[Array, "n"]) -> Float64[Array, "n"]:
    """Row coordinates, at the columns x, of the segments with the indices `which`."""
    start = segments.start_px[which]
    y: Float64[Array, "n"] = start[:, 1] + _slope(segments)[which] * (x - start[:, 0])
    return y


def _contrast(
    signal: UInt[Array, "row column"],
    segments: Segments,
    pairs: tuple[Int64[Array, "pair"], Int64[Array, "pair"]],
    shared: tuple[Int64[Array, "pair"], Int64[Array, "pair"]],
) -> Float64[Array, "pair"]:
    """Median brightness between the edges minus that outside them, over samples of the common columns."""
    along = np.linspace(0, 1, 9)
    x = np.rint(shared[0][:, None] + (shared[1] - shared[0])[:, None] * along)
    column = x.astype(np.int64)
    upper, lower = (_ordinate(segments, np.repeat(each, len(along)), x.ravel()).reshape(x.shape) for each in pairs)

    def brightness(y: Float64[Array, "pair column"]) -> Float64[Array, "pair"]:
        row = np.clip(np.rint(y).astype(np.int64), 0, signal.shape[0] - 1)
        return np.asarray(np.median(signal[row, column].astype(np.float64), axis=-1))

    middle, width = (upper + lower) / 2, lower - upper
    outside = np.maximum(brightness(middle - 1.2 * width), brightness(middle + 1.2 * width))
    difference: Float64[Array, "pair"] = brightness(middle) - outside
    return difference
