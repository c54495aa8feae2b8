"""Views of a board, each with the pose of the robot, which rested or moved."""

from dataclasses import dataclass, field, replace

import numpy as np

from ringpose.calibrate.mount.closed_form import Transform
from ringpose.calibrate.mount.moving import ToolMotion, moved
from ringpose.calibrate.mount.stripes import Stripes
from ringpose.types.arrays import Array, Float64
from ringpose.types.board import BoardView


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Station:
    """One view of the board, and the pose that the robot reported for it."""

    view: BoardView
    base_from_tool: Transform
    location: str = ""
    """File and line of the robot's pose."""
    sighting: "Sighting | None" = None
    """When the board was seen, if the robot moved."""
    twist: Float64[Array, "6"] = field(default_factory=lambda: np.zeros(6))
    """Rate (rad/s) and velocity (m/s) of the tool, in its frame."""
    stripes: Stripes | None = None
    """Stripes on the board, if the light planes are among the unknowns."""
    interpolation_sd: Float64[Array, "6"] = field(default_factory=lambda: np.zeros(6))
    """Of the robot's pose between two that it reported: rotation vector, translation, in the tool frame."""

    @property
    def name(self) -> str:
        """Name of the image."""
        return self.view.name

    @property
    def has_delay(self) -> bool:
        """Whether the delay is one of the unknowns."""
        return self.sighting is not None and not self.sighting.is_held

    @property
    def delay_s(self) -> float:
        """The delay to which the robot's pose belongs."""
        return 0.0 if self.sighting is None else self.sighting.delay_s

    def at(self, delay_s: float) -> "Station":
        """With the robot's pose at another delay; unchanged if the robot was at rest.

        Where the robot's poses do not cover it, the tool is taken to go on at its twist.
        """
        if self.sighting is None:
            return self
        sighting, stamp_s = replace(self.sighting, delay_s=delay_s), self.sighting.stamp_s + delay_s
        instant = sighting.motion.at(stamp_s)
        if instant is None:
            further = moved(self.base_from_tool, (delay_s - self.delay_s) * self.twist)
            return replace(self, base_from_tool=further, sighting=sighting)
        return replace(
            self, base_from_tool=instant.base_from_tool, twist=instant.twist, sighting=sighting,
            interpolation_sd=instant.interpolation_sd, location=sighting.motion.location_at(stamp_s),
        )  # fmt: skip

    def held_at(self, delay_s: float) -> "Station":
        """With the robot's pose at a delay that is not estimated."""
        there = self.at(delay_s)
        return there if there.sighting is None else replace(there, sighting=replace(there.sighting, is_held=True))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Sighting:
    """When a moving robot saw the board."""

    motion: ToolMotion
    stamp_s: float
    """Middle of the exposure, by the camera's clock."""
    exposure_s: float = 0.0
    delay_s: float = 0.0
    """The delay to which the robot's pose belongs: the robot's stamp is `stamp_s` + `delay_s`."""
    is_held: bool = False
    """Whether this delay is not estimated, as the views do not determine it."""
