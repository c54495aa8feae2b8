from ringpose.types.arrays import Array

def places(arcs: Array, covariance: Array, lens: Array, rules: Array, /) -> bytes: ...
def profiles(
    image: Array, place: Array, normal: Array, rules: Array, value: Array, saturated: Array, noise: Array, /
) -> None: ...
def steps(
    value: Array,
    saturated: Array,
    noise: Array,
    across: Array,
    place: Array,
    unit: Array,
    table: Array,
    rules: Array,
    /,
) -> bytes: ...
def fit(
    arcs: Array,
    plane_point: Array,
    plane_sigma: Array,
    reference: Array,
    ray: Array,
    side: Array,
    sigma: Array,
    rules: Array,
    /,
) -> bytes: ...
