"""A table of results, which is written as text, as CSV, or into a page."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

Cell = str | float | int | bool | None
"""A value; None where there is none."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Table:
    """Rows of cells under headings."""

    headings: Sequence[str]
    rows: Iterable[Sequence[Cell]]
    """Of a table for readers, the cells are texts; otherwise values in SI units. An iterator is read once."""

    def lines(self, left: int = 1) -> list[str]:
        """The table as aligned text: the first `left` columns to the left, the others to the right."""
        rows = [list(map(str, row)) for row in (self.headings, *self.rows)]
        widths = [max(len(row[column]) for row in rows) for column in range(len(rows[0]))]
        return [
            "  ".join(
                cell.ljust(width) if column < left else cell.rjust(width)
                for column, (cell, width) in enumerate(zip(row, widths, strict=True))
            ).rstrip()
            for row in rows
        ]
