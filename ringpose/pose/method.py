"""The names of the methods, which the command line needs before anything heavy is imported."""

from enum import StrEnum


class Method(StrEnum):
    """How the pose is computed."""

    ML = "ml"
    PAPER = "paper"
    PAPER_CONSTRAINED = "paper-constrained"
