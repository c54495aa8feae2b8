from ringpose.types.arrays import Array

_Numbers = tuple[float, ...]
_Group = tuple[tuple[int, ...], tuple[int, ...], float, float]

def faces(
    tracks: Array, unlabelled: int, planes: Array, rules: tuple[_Numbers, _Numbers, _Numbers], /
) -> tuple[bytes, tuple[_Group, _Group, _Group]]: ...
