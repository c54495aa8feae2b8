"""Figures of a report as PNG, drawn by matplotlib (extra `report`)."""

import io
import warnings

from matplotlib.figure import Figure

DOTS_PER_INCH = 110


def canvas(width_in: int | float, height_in: int | float) -> Figure:
    """An empty figure of this size, without matplotlib's global state."""
    return Figure(figsize=(width_in, height_in), dpi=DOTS_PER_INCH, layout="constrained")


def png_of(figure: Figure) -> bytes:
    """The figure as a PNG file."""
    stream = io.BytesIO()
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "Glyph .* missing")  # letters missing in the font are drawn as boxes
        figure.savefig(stream, format="png", metadata={"Software": None})
    return stream.getvalue()


def drawn(name: str) -> str:
    """A name as a literal label: dollar signs and undecodable bytes are escaped, and a leading underscore is shown."""
    shown = name.encode(errors="backslashreplace").decode().replace("$", r"\$")
    return f" {shown}" if shown.startswith("_") else shown
