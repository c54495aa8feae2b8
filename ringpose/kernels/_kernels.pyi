from ringpose.types.arrays import Array

_Record = object
"""A data class of `ringpose.kernels.kernel_record`."""
RECORDS: dict[str, dict[str, type]]
"""Names and types of the members of the C structs."""

TABLES: dict[str, dict[str, int]]
"""Names of the members of the structs of tables' rows, with the number of columns of each."""

MAX_CUT: int
COLUMNS_PER_CUT: int
BLOCK: int
CELL: int
STEPS_PER_DN: int
EMPTY: int
THIN: int
BOX: int
REVOLUTION: int
RELIEF_TEXELS: int
MAX_PARTS: int
MAX_POINTS: int
MAX_LASERS: int

_Group = tuple[tuple[int, ...], tuple[int, ...], float, float]
_Chord = tuple[int, int, int, int, int, tuple[float, float, float, float]]

def gradient(image: Array, bits: int, upper: int, magnitude: Array, /) -> tuple[bytes, bytes]: ...
def chains(
    magnitude: Array, anchors: Array, orientation: Array, lower: int, shortest: int, /
) -> tuple[bytes, bytes]: ...
def cuts(
    pixels: Array, starts: Array, deviation: float, share_change: float, window: int, shortest: int, /
) -> bytes: ...
def fits(magnitude: Array, pixels: Array, pieces: Array, trim: int, /) -> tuple[bytes, bytes]: ...
def joins(
    lines: Array, moments: Array, pieces: Array, gap: float, aside: float, shortest: int, /
) -> tuple[bytes, bytes]: ...
def stripes(
    image: Array, dark: Array | None, bands: Array | None, taps: Array, filters: Array, params: _Record, /
) -> tuple[bytes, bytes, bytes, bytes]: ...
def stripe_segments(
    position: Array, sigma: Array, piece: Array, laser: Array, lens: _Record, params: _Record, /
) -> bytes: ...
def arcs(points: Array, arc: Array, arcs: Array, /) -> None: ...
def faces(
    segments: Array,
    unlabelled: int,
    planes: Array,
    bends: Array | None,
    unions: _Record,
    candidates: _Record,
    ring: _Record,
    /,
) -> tuple[bytes, tuple[_Group, _Group, _Group], tuple[float, float, tuple[_Chord, ...]]]: ...
def ends(images: tuple[tuple[Array, Array | None, Array], ...], lens: _Record, params: _Record, /) -> bytes: ...
def edge_places(
    point: Array,
    off_face: Array,
    sign: Array,
    number: Array,
    normal: Array,
    wrt_step: Array | None,
    covariance: Array | None,
    lens: _Record,
    params: _Record,
    /,
) -> bytes: ...
def edge_profiles(
    image: Array, place: Array, normal: Array, params: _Record, value: Array, saturated: Array, noise: Array, /
) -> None: ...
def edge_steps(
    value: Array,
    saturated: Array,
    noise: Array,
    across: Array,
    place: Array,
    unit: Array,
    table: Array,
    params: _Record,
    /,
) -> bytes: ...
def render(*arguments: object) -> None: ...
def hits(*arguments: object) -> None: ...
def code_edges(code: Array, edge: Array, /) -> None: ...
