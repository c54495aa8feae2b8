from ringpose.types.arrays import Array

_Group = tuple[tuple[int, ...], tuple[int, ...], float, float]

def faces(tracks: Array, unlabelled: int, planes: Array, rules: Array, /) -> tuple[bytes, _Group, _Group, _Group]: ...
