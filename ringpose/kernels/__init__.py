"""The hot loops in C, by stage: each folder contains C sources and the types of their arguments.

A kernel that only one module of `ringpose.detect` uses is called there directly, through a typed function.

The arguments are validated in one place, `arguments.c`. There is no fallback in Python: it would be about a hundred
times slower without any notice.

Parameters cross the border by name: a kernel reads the attributes of a data class (`kernel_record`) into the members of
a C struct. So do the columns of tables (`column_names`, `column_slices`): they are the members of the struct of a row.
"""

from dataclasses import fields
from itertools import accumulate
from typing import TypeVar

try:
    from ringpose.kernels import _kernels as _kernels
except ImportError as error:
    raise ImportError(
        "ringpose.kernels: the C kernels are not built for this Python; run `pip install .` where ringpose's source is"
        " (a C compiler is needed)"
    ) from error

_Record = TypeVar("_Record", bound=type)


def kernel_record(record: _Record) -> _Record:
    """The data class, if its fields are those of the C struct of the same name, by name and type (float or int).

    Raises TypeError otherwise, that is when its module is imported.
    """
    declared = _kernels.RECORDS[record.__name__]
    described = {field.name: field.type for field in fields(record)}
    if described != declared:
        differing = sorted({name for name, _ in described.items() ^ declared.items()})
        raise TypeError(f"{record.__name__}: differs from the C struct in {', '.join(differing)}")
    return record


def column_names(table: str) -> tuple[str, ...]:
    """The columns of a table of which each is one number: the members of the C struct of its rows."""
    return tuple(_kernels.TABLES[table])


def column_slices(table: str) -> dict[str, slice]:
    """Where the members of the C struct of a table's rows are in a row of numbers."""
    counts = _kernels.TABLES[table]
    ends = accumulate(counts.values())
    return {name: slice(end - count, end) for (name, count), end in zip(counts.items(), ends, strict=True)}
