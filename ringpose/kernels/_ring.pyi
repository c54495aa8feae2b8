from ringpose.types.arrays import Array

_Numbers = tuple[float, ...]

def tracks(position: Array, sigma: Array, piece: Array, laser: Array, lens: _Numbers, rules: _Numbers, /) -> bytes: ...
def ends(lit: Array, dark: Array | None, lines: Array, lens: _Numbers, rules: _Numbers, /) -> bytes: ...
def marks(
    tracks: Array,
    ends: Array,
    lasers: tuple[int, ...],
    rules: _Numbers,
    position: Array,
    covariance: Array,
    flags: Array,
    straight: Array,
    sigma: Array,
    /,
) -> None: ...
def arcs(
    position: Array, covariance: Array, planes: Array, lens: _Numbers, circle_sigma: float, exact: int, /
) -> tuple[tuple[int, int], float, _Numbers, float, float]: ...
