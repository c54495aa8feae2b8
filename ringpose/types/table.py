"""A table of results, which is written as text, as CSV, or into a page."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

Cell = str | float | int | bool | None
"""A value; None where there is none."""

WIDTH = 80
"""Columns of a terminal that a table fits into."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Table:
    """Rows of cells under headings."""

    headings: Sequence[str]
    rows: Iterable[Sequence[Cell]]
    """Of a table for readers, the cells are texts; otherwise values in SI units. An iterator is read once."""

    def lines(self, left: int = 1) -> list[str]:
        """The table as aligned text: the first `left` columns to the left, the others to the right.

        A table wider than `WIDTH` continues below, after an empty line, with its first `left` columns repeated.
        """
        rows = [list(map(str, row)) for row in (self.headings, *self.rows)]
        widths = [max(len(row[column]) for row in rows) for column in range(len(rows[0]))]
        parts: list[list[int]] = [[]]
        for column in range(left, len(widths)):
            if parts[-1] and sum(widths[each] + 2 for each in (*range(left), *parts[-1], column)) - 2 > WIDTH:
                parts.append([])
            parts[-1].append(column)
        lines: list[str] = []
        for part in parts:
            lines += [""] if lines else []
            for row in rows:
                cells = [row[each].ljust(widths[each]) for each in range(left)]
                lines.append("  ".join([*cells, *(row[each].rjust(widths[each]) for each in part)]).rstrip())
        return lines
