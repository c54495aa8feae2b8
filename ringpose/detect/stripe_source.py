"""What stripes are made from; apart from the pipeline, so that a help text need not import it."""

from enum import StrEnum


class StripeSource(StrEnum):
    """What the stripes' pieces are made from."""

    CENTERS = "centers"
    """Ridges, column by column: finer, and what is used unless the paper's way is asked for."""
    SEGMENTS = "segments"
    """The paper's line segments along both edges of each stripe."""
