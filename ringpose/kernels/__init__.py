"""The hot loops in C, by stage: each folder contains C sources and the types of their arguments.

A kernel that only one module of `ringpose.detect` uses is called there directly, through a typed function.

The arguments are validated in one place, `arguments.c`. There is no fallback in Python: it would be about a hundred
times slower without any notice.
"""

try:
    from ringpose.kernels import _kernels as _kernels
except ImportError as error:
    raise ImportError(
        "ringpose.kernels: the C kernels are not built for this Python; run `pip install .` where ringpose's source is"
        " (a C compiler is needed)"
    ) from error
