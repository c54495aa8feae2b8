"""The line detector's kernels again (ringpose-method(7), section 2), written to be read.

The oracle of `ringpose.kernels`, equal to it bit for bit.
"""

import math
from itertools import pairwise

import numpy as np

from ringpose.types.arrays import Array, Bool, Float64, Int16, Int32, Int64, UInt8, UInt16

STEPS = ((1, 0), (1, 1), (0, 1), (-1, 1), (-1, 0), (-1, -1), (0, -1), (1, -1))
"""The eight directions as (x, y), clockwise as seen; opposite directions differ by 4."""

MARGIN = 3
"""The gradient of a pixel comes from the 7 x 7 pixels around it, and is 0 where they leave the image."""

INNER = (slice(MARGIN, -MARGIN), slice(MARGIN, -MARGIN))

ANCHOR_SPACING = 8
"""Anchors lie in columns whose number is a multiple of it, those of upright edges in such rows."""

ALONG_Y = 2
"""Orientation of an upright edge."""

WALL = 1 << 15
"""More than any magnitude: what the margin has for the walks."""


def gradient(
    image: UInt8[Array, "row column"] | UInt16[Array, "row column"], upper: int, bits: int = 8
) -> tuple[Int16[Array, "row column"], Int32[Array, "anchor"], UInt8[Array, "anchor"]]:
    """Twin of `ringpose.kernels.gradient`."""
    magnitude = np.zeros(image.shape, np.int16)
    orientation = np.zeros(image.shape, np.uint8)
    is_upright = np.zeros(image.shape, bool)
    if min(image.shape) > 2 * MARGIN:
        gx, gy = sobel(smoothed(image, bits))
        most, least = np.maximum(abs(gx), abs(gy)), np.minimum(abs(gx), abs(gy))
        magnitude[INNER] = most + (3 * least >> 3)
        straight = np.where(abs(gx) > abs(gy), ALONG_Y, 0)
        diagonal = np.where((gx < 0) != (gy < 0), 1, 3)
        orientation[INNER] = np.where(2 * least < most, straight, diagonal)
        is_upright[INNER] = straight == ALONG_Y
    anchors = np.flatnonzero(is_maximum(magnitude, is_upright) & has_anchors(is_upright) & (magnitude >= upper))
    return magnitude, anchors.astype(np.int32), orientation.ravel()[anchors]


def smoothed(
    image: UInt8[Array, "row column"] | UInt16[Array, "row column"], bits: int
) -> Int64[Array, "row-4 column-4"]:
    """The image under the binomial 1 4 6 4 1 along both axes, in 1/16 of the 256th part of its range."""
    height, width = image.shape
    weights = np.array([1, 4, 6, 4, 1])
    down = np.tensordot(weights, [image[i : height - 4 + i] for i in range(5)], axes=1)
    both: Int64[Array, "row-4 column-4"] = np.tensordot(weights, [down[:, i : width - 4 + i] for i in range(5)], axes=1)
    return both + (1 << bits - 5) >> bits - 4


def sobel(image: Int64[Array, "row column"]) -> tuple[Int64[Array, "row-2 column-2"], Int64[Array, "row-2 column-2"]]:
    """Sobel differences along x and y of the inner pixels."""
    along = image[:-2] + 2 * image[1:-1] + image[2:]
    across = image[2:] - image[:-2]
    return along[:, 2:] - along[:, :-2], across[:, :-2] + 2 * across[:, 1:-1] + across[:, 2:]


def is_maximum(
    magnitude: Int16[Array, "row column"], is_upright: Bool[Array, "row column"]
) -> Bool[Array, "row column"]:
    """Where the magnitude is a maximum along the row of an upright edge or down the column of another.

    Its neighbours must all have a gradient; of two equal ones it is the earlier in raster order.
    """
    maximum = np.zeros(magnitude.shape, bool)
    for axis, edges in ((0, ~is_upright), (1, is_upright)):
        before, after = np.roll(magnitude, 1, axis), np.roll(magnitude, -1, axis)
        maximum |= edges & (magnitude > before) & (magnitude >= after)
    within = np.zeros(magnitude.shape, bool)
    within[MARGIN + 1 : -MARGIN - 1, MARGIN + 1 : -MARGIN - 1] = True
    return maximum & within


def has_anchors(is_upright: Bool[Array, "row column"]) -> Bool[Array, "row column"]:
    """Where anchors may lie: an edge passes there every few pixels, whatever its direction."""
    row, column = np.indices(is_upright.shape)
    has: Bool[Array, "row column"] = np.where(is_upright, row, column) % ANCHOR_SPACING == 0
    return has


def chains(
    magnitude: Int16[Array, "row column"],
    anchors: Int32[Array, "anchor"],
    orientation: UInt8[Array, "anchor"],
    lower: int,
    shortest: int,
) -> tuple[Int32[Array, "pixel xy=2"], Int32[Array, "start"]]:
    """Twin of `ringpose.kernels.chains`."""
    height, width = magnitude.shape
    inner = {(x, y) for x in range(MARGIN, width - MARGIN) for y in range(MARGIN, height - MARGIN)}
    free = {(x, y): int(magnitude[y, x]) if (x, y) in inner else WALL for y, x in np.ndindex(magnitude.shape)}
    taken = {pixel: pixel not in inner for pixel in free}
    found: list[list[tuple[int, int]]] = []
    for number in np.argsort(-magnitude.ravel()[anchors].astype(np.int64), kind="stable"):
        y, x = divmod(int(anchors[number]), width)
        if taken[x, y] or free[x, y] < lower:
            continue
        taken[x, y] = True
        direction = int(orientation[number])
        back = walk(free, taken, (x, y), direction + 4, lower)
        forth = walk(free, taken, (x, y), direction, lower)
        found.append([*reversed(back), (x, y), *forth])
    long = [chain for chain in found if len(chain) >= shortest]
    pixels = np.array([pixel for chain in long for pixel in chain], np.int32).reshape(-1, 2)
    return pixels, np.cumsum([0, *map(len, long)], dtype=np.int32)


def walk(
    magnitude: dict[tuple[int, int], int],
    taken: dict[tuple[int, int], bool],
    at: tuple[int, int],
    direction: int,
    lower: int,
) -> list[tuple[int, int]]:
    """One walk from a taken pixel; marks what it takes."""
    path: list[tuple[int, int]] = []
    while True:
        ahead = [(direction + turn) % 8 for turn in (0, -1, 1)]
        pixels = [(at[0] + STEPS[way][0], at[1] + STEPS[way][1]) for way in ahead]
        best = max(range(3), key=lambda i: magnitude[pixels[i]])
        at, direction = pixels[best], ahead[best]
        if taken[at] or magnitude[at] < lower:
            return path
        taken[at] = True
        path.append(at)


def cuts(
    pixels: Int32[Array, "pixel xy=2"],
    starts: Int32[Array, "start"],
    deviation_px: float,
    share_change: float,
    window: int,
    shortest: int,
) -> Int32[Array, "piece end=2"]:
    """Twin of `ringpose.kernels.cuts`."""
    pieces = []
    for first, end in zip(starts[:-1].tolist(), starts[1:].tolist(), strict=True):
        chain = pixels[first:end].tolist()
        at = 0
        while len(chain) - at >= shortest:
            length = piece_length(chain[at:], deviation_px, share_change, window)
            if length + 1 >= shortest:
                pieces.append((first + at, first + at + length))
            at += length
            if at == len(chain) - 1:
                break
    return np.array(pieces, np.int32).reshape(-1, 2)


def piece_length(chain: list[list[int]], deviation_px: float, share_change: float, window: int) -> int:
    """Steps from the start of the chain to the end of its first straight piece."""
    kinds = ["hvo"[0 if a[1] == b[1] else 1 if a[0] == b[0] else 2] for a, b in pairwise(chain)]
    head = kinds[:window]
    for k in range(1, len(chain)):
        h, v, o = (kinds[:k].count(kind) for kind in "hvo")
        if math.sqrt((h + o) ** 2 + (v + o) ** 2) - chord(chain[0], chain[k]) > deviation_px:
            return farthest(chain[: k + 1])
        recent = kinds[k - window : k]
        if k > window and sum(abs(recent.count(kind) - head.count(kind)) for kind in "hvo") > share_change * window:
            return k - window // 2
    return len(chain) - 1


def chord(start: list[int], end: list[int]) -> float:
    """Distance of two pixels."""
    return math.sqrt((end[0] - start[0]) ** 2 + (end[1] - start[1]) ** 2)


def farthest(chain: list[list[int]]) -> int:
    """Number of the first pixel that lies farthest from the chord."""
    (x0, y0), (x1, y1) = chain[0], chain[-1]
    off = [abs((x1 - x0) * (y - y0) - (y1 - y0) * (x - x0)) for x, y in chain[:-1]]
    return max(1, off.index(max(off)))


def fits(
    magnitude: Int16[Array, "row column"],
    pixels: Int32[Array, "pixel xy=2"],
    pieces: Int32[Array, "piece end=2"],
    trim: int,
) -> tuple[Float64[Array, "piece end=2 xy=2"], Float64[Array, "piece moment=6"]]:
    """Twin of `ringpose.kernels.fits`."""
    fitted = [fit(magnitude, pixels[first : last + 1].tolist(), trim) for first, last in pieces.tolist()]
    lines = np.array([ends for ends, _ in fitted], np.float64).reshape(-1, 2, 2)
    return lines, np.array([moments for _, moments in fitted], np.float64).reshape(-1, 6)


def fit(
    magnitude: Int16[Array, "row column"], piece: list[list[int]], trim: int
) -> tuple[list[list[float]], list[float]]:
    """Both ends of the line of one piece, and the moments of its crests."""
    start, end = piece[0], piece[-1]
    flat = abs(end[0] - start[0]) >= abs(end[1] - start[1])
    trim = min(trim, len(piece) // 4)
    moments = [0.0] * 6
    for x, y in piece[trim : len(piece) - trim]:
        shift = crest(magnitude, x, y, flat)
        if shift is not None:
            at_x, at_y = x + (0.0 if flat else shift), y + (shift if flat else 0.0)
            terms = (1.0, at_x, at_y, at_x * at_x, at_x * at_y, at_y * at_y)
            moments = [a + b for a, b in zip(moments, terms, strict=True)]
    straight = line_through(moments, flat)
    ends = [[float(x), float(y)] for x, y in (start, end)]
    return (ends if straight is None else [on_line(end, straight, flat) for end in ends]), moments


def line_through(moments: list[float], flat: bool) -> tuple[float, float] | None:
    """Slope and offset of y over x, or of x over y if not flat; None if the points do not determine it."""
    count, x, y, xx, xy, yy = moments
    u, v, uu = (x, y, xx) if flat else (y, x, yy)
    spread = count * uu - u * u
    if not spread > 0:
        return None
    slope = (count * xy - u * v) / spread
    return slope, (v - slope * u) / count


def on_line(point: list[float], line: tuple[float, float], flat: bool) -> list[float]:
    """The point of the line at the same place along its longer side."""
    slope, offset = line
    return [point[0], offset + slope * point[0]] if flat else [offset + slope * point[1], point[1]]


def crest(magnitude: Int16[Array, "row column"], x: int, y: int, flat: bool) -> float | None:
    """Shift of the crest from the pixel's centre across the edge; None where the pixel is no maximum."""
    height, width = magnitude.shape
    if not (0 < x < width - 1 and 0 < y < height - 1):
        return None
    across = magnitude[y - 1 : y + 2, x] if flat else magnitude[y, x - 1 : x + 2]
    before, here, after = across.tolist()
    curvature = before - 2 * here + after
    if before > here or after > here or curvature == 0:
        return None
    return float((before - after) / (2.0 * curvature))
