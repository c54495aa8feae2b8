"""The hot loops in C, by stage: each folder has its sources and typed functions that call them.

The arguments are checked against a table in `arguments.c`. There is no fallback in Python: it would be some hundred
times slower, and silently so.
"""

try:
    from ringpose.kernels import _kernels as _kernels
except ImportError as error:
    raise ImportError(
        "ringpose.kernels: the C kernels are not built for this Python; run `pip install .` where ringpose's source is"
        " (a C compiler is needed)"
    ) from error
