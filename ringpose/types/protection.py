"""How far a pose may be off: the record of protection levels, and the solutions under all hypotheses behind it."""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from math import inf
from typing import Annotated

import numpy as np

from ringpose.types.arrays import Array, Float64
from ringpose.types.record import Key

WRONG_SIGMAS = 5.0
"""A quantity farther from the truth than this (Mahalanobis distance), and without a flag that names it, is wrong."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Protection:
    """Protection levels (ringpose-method(7), section 15); infinite, in the record null, where there is none."""

    risk: Annotated[
        float,
        Key("The probability with which an error may exceed its level, for each quantity by itself.", least=0.0),
    ]
    uncovered: Annotated[
        float,
        Key(
            "The part of `risk` for what is no hypothesis of the levels, by studies of simulated shots (p_u).",
            least=0.0,
        ),
    ]
    grasp_normal_m: Annotated[float, Key("Level of the grasp point's error along the normal.", null=inf, least=0.0)]
    grasp_radial_m: Annotated[
        float, Key("Level of its error in the ring's plane, across the face.", null=inf, least=0.0)
    ]
    normal_rad: Annotated[float, Key("Level of the angle between the normal and the true one.", null=inf, least=0.0)]
    center_m: Annotated[
        Float64[Array, "xyz=3"],
        Key("Levels of the centre's error along each axis of the frame; null if one of them is.", null=inf),
    ]
    sd_factor: Annotated[
        float,
        Key(
            "Factor on the standard deviations in `covariance`, from 1, for a light plane that may have moved without "
            "showing.",
            added=True,
            least=1.0,
        ),
    ] = 1.0

    def without(self, quantities: frozenset[str]) -> "Protection":
        """The levels without those of these quantities: `grasp`, `normal`, `center`."""
        return replace(
            self,
            grasp_normal_m=inf if "grasp" in quantities else self.grasp_normal_m,
            grasp_radial_m=inf if "grasp" in quantities else self.grasp_radial_m,
            normal_rad=inf if "normal" in quantities else self.normal_rad,
            center_m=np.full(3, inf) if "center" in quantities else self.center_m,
        )


GRASP, TILTS, CENTER, INWARD = slice(0, 2), slice(2, 4), slice(4, 7), 7
"""The separated quantities: grasp point along the normal and radially; tilts of the normal, centre by axis, inward."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Separation:
    """The solutions of one shot under all hypotheses, the accepted one first; quantities as in `GRASP` and so on."""

    faults: tuple[str, ...]
    """Names of what may be wrong."""
    sets: tuple[tuple[int, ...], ...]
    """The faults of each hypothesis."""
    weight: Float64[Array, "hypothesis"]
    """Posterior probabilities."""
    difference: Float64[Array, "hypothesis quantity=8"]
    """Differences d_j from the accepted solution."""
    covariance: Float64[Array, "hypothesis quantity=8 quantity=8"]
    across: Float64[Array, "2 xyz=3"]
    """The normal, and the direction outwards from the ring's centre, at the grasp point."""
    radius_m: float
    """Mean radius of the accepted ring."""
    rotation: Float64[Array, "3 3"] = field(default_factory=lambda: np.eye(3))
    """From the camera's axes, or those of its image turned by a quarter, in which it was estimated."""

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the hypotheses; empty for that of no fault."""
        return tuple("+".join(self.faults[number] for number in each) for each in self.sets)

    def turned(self, rotation: Float64[Array, "3 3"]) -> "Separation":
        """The same in a frame with other axes; the basis of the tilts does not matter."""
        change = np.eye(8)
        change[CENTER, CENTER] = rotation
        return replace(
            self,
            difference=self.difference @ change.T,
            covariance=change @ self.covariance @ change.T,
            across=self.across @ rotation.T,
            rotation=rotation @ self.rotation,
        )


def turned(separation: Callable[[], Separation], rotation: Float64[Array, "3 3"]) -> Callable[[], Separation]:
    """What computes the same in a frame with other axes."""
    return lambda: separation().turned(rotation)
