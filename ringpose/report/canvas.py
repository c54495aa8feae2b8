"""What matplotlib (extra `report`) draws on; modules of pictures are imported only where a report is asked for."""

import io
import warnings

from matplotlib.figure import Figure

DOTS_PER_INCH = 110


def canvas(width_in: int | float, height_in: int | float) -> Figure:
    """An empty figure of so many inches, of no global state."""
    return Figure(figsize=(width_in, height_in), dpi=DOTS_PER_INCH, layout="constrained")


def png_of(figure: Figure) -> bytes:
    """The figure as a PNG file."""
    stream = io.BytesIO()
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "Glyph .* missing")  # a name's letters that the font lacks are drawn as boxes
        figure.savefig(stream, format="png", metadata={"Software": None})
    return stream.getvalue()


def drawn(name: str) -> str:
    """A name as a label that shows it: no formula between dollars, no byte that is no letter, in every legend."""
    shown = name.encode(errors="backslashreplace").decode().replace("$", r"\$")
    return f" {shown}" if shown.startswith("_") else shown
