from ringpose.types.arrays import Array

def search(
    state: Array,
    rays: Array,
    light: Array,
    whitening: Array,
    points: Array,
    edge_rays: Array,
    edges: Array,
    radii: Array,
    common: Array,
    left: Array,
    rules: Array,
    first: int,
    last: int,
    /,
) -> bytes: ...
def start(rays: Array, light: Array, whitening: Array, points: Array, middle: Array, /) -> bytes: ...
