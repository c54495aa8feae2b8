from ringpose.types.arrays import Array

_Numbers = tuple[float, ...]
_Group = tuple[tuple[int, ...], tuple[int, ...], float, float]

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
    image: Array, dark: Array | None, bands: Array | None, taps: Array, filters: Array, params: _Numbers, /
) -> tuple[bytes, bytes, bytes, bytes]: ...
def tracks(position: Array, sigma: Array, piece: Array, laser: Array, lens: _Numbers, params: _Numbers, /) -> bytes: ...
def faces(
    tracks: Array, unlabelled: int, planes: Array, unions: _Numbers, candidates: _Numbers, ring: _Numbers, /
) -> tuple[bytes, tuple[_Group, _Group, _Group]]: ...
def ends(images: tuple[tuple[Array, Array | None, Array], ...], lens: _Numbers, params: _Numbers, /) -> bytes: ...
def edge_places(
    point: Array,
    off_face: Array,
    sign: Array,
    number: Array,
    normal: Array,
    wrt_step: Array | None,
    covariance: Array | None,
    lens: _Numbers,
    params: _Numbers,
    /,
) -> bytes: ...
def edge_profiles(
    image: Array, place: Array, normal: Array, params: _Numbers, value: Array, saturated: Array, noise: Array, /
) -> None: ...
def edge_steps(
    value: Array,
    saturated: Array,
    noise: Array,
    across: Array,
    place: Array,
    unit: Array,
    table: Array,
    params: _Numbers,
    /,
) -> bytes: ...
def render(*arguments: object) -> None: ...
def hits(*arguments: object) -> None: ...
def code_edges(code: Array, edge: Array, /) -> None: ...
