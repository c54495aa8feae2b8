"""What matplotlib (extra `report`) draws on; modules of pictures are imported only where a report is asked for."""

import io

from matplotlib.figure import Figure

DOTS_PER_INCH = 110


def canvas(width_in: int | float, height_in: int | float) -> Figure:
    """An empty figure of so many inches, of no global state."""
    return Figure(figsize=(width_in, height_in), dpi=DOTS_PER_INCH, layout="constrained")


def png_of(figure: Figure) -> bytes:
    """The figure as a PNG file."""
    stream = io.BytesIO()
    figure.savefig(stream, format="png", metadata={"Software": None})
    return stream.getvalue()
