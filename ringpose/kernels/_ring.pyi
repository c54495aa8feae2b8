from ringpose.types.arrays import Array

_Group = tuple[int, int, int, float, float]

def groups(
    track: Array, laser: Array, ends: Array, merit: Array, planes: Array, parameters: Array, /
) -> tuple[_Group, _Group, _Group]: ...
def tracks(
    column: Array, row: Array, sigma: Array, piece: Array, laser: Array, lens: Array, rules: Array, /
) -> bytes: ...
def ends(lit: Array, dark: Array | None, lines: Array, lens: Array, rules: Array, /) -> bytes: ...
