"""How straight segments are made from edge chains."""

from enum import StrEnum


class SegmentMethod(StrEnum):
    """The methods by the names under which they are chosen."""

    LENGTH = "length"
    """The paper's: chords from the first to the last pixel of straight pieces."""
    REFINED = "refined"
    """Sub-pixel least-squares lines of straight pieces, those joined that continue one another."""
