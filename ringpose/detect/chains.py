"""Edge chains: continuous, one pixel wide (ringpose-method(7), section 2)."""

from dataclasses import dataclass

from ringpose.detect.gradient import Gradient, magnitude_steps
from ringpose.kernels import segments as kernels
from ringpose.types.arrays import Array, Int32


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Chains:
    """Pixels of all chains, one chain after another."""

    pixels: Int32[Array, "pixel xy=2"]
    starts: Int32[Array, "start"]
    """Chain i is `pixels[starts[i]:starts[i + 1]]`."""


def edge_chains(gradient: Gradient, lower_dn: float, shortest: int) -> Chains:
    """Walks from the anchors over all pixels of at least `lower_dn`; chains of `shortest` pixels and more."""
    pixels, starts = kernels.chains(
        gradient.magnitude, gradient.anchors, gradient.orientation, magnitude_steps(lower_dn), shortest
    )
    return Chains(pixels=pixels, starts=starts)
