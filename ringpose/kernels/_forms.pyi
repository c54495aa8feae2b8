from ringpose.types.arrays import Array

def forms(points: Array, edges: Array, constrained: bool, singular_below: float, /) -> bytes: ...
def derivatives(points: Array, edges: Array, constrained: bool, singular_below: float, step: float, /) -> bytes: ...
def misfit(
    points: Array,
    edges: Array,
    normals: Array,
    positions: Array,
    normal: Array,
    center: Array,
    radii: Array,
    matrix: Array,
    coefficients: Array,
    offset_m: float,
    /,
) -> float: ...
def rows(state: Array, rays: Array, light: Array, whitening: Array, points: Array, /) -> bytes: ...
def spread(points: Array, normals: Array, covariances: Array, matrix: Array, coefficients: Array, /) -> bytes: ...
def plane(points: Array, /) -> bytes: ...
