"""Rendered frames of 1600 x 1200 pixels, kept in memory: a ring on a body of foil, in the dark and in light.

Of each mask of lasers there are several frames of one view, which differ in their noise.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import count
from pathlib import Path

import numpy as np

from ringpose.files.scenes.scene import read_scene
from ringpose.simulate.pipeline import render_ring_view
from ringpose.types.arrays import Array, UInt8
from ringpose.types.image import Shot
from ringpose.types.rig import Rig

FULL_SCENE = Path(__file__).parents[2] / "examples" / "scene-full.yaml"

LIGHTS = {"dark": "dim", "light": "normal"}
"""Names of the lights in the scene: the lasers alone, and with a laboratory's light."""

ALL, SWITCHED = (0b111,), (0, 0b001, 0b010, 0b100, 0)
"""Masks of the frames of a shot with all lasers on, and of one that switches them."""

NOISES = 6
"""Frames of each mask."""

START_S, FRAME_S = 1.0e9, 0.02


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Frames:
    """The frames of a view by their masks."""

    rig: Rig
    exposure_s: float
    of_mask: dict[int, UInt8[Array, "frame row column"]]

    def shot(self, number: int, masks: tuple[int, ...], stamp_s: float) -> Shot:
        """A shot with frames of these masks; `number` chooses their noise."""
        images = np.stack([self.of_mask[mask][(number + k) % NOISES] for k, mask in enumerate(masks)])
        return Shot(
            name=f"shot_{number:06d}",
            images=images,
            lasers=np.array(masks, dtype=np.uint8),
            stamp_s=stamp_s + FRAME_S * np.arange(len(masks)),
            exposure_s=np.full(len(masks), self.exposure_s),
        )

    def tracked(self) -> Iterator[Shot]:
        """Shots as a live track chooses them: three that switch the lasers, then frames with all lasers on.

        Every tenth of these comes with one without lasers.
        """
        stamp_s = START_S
        for number in count():
            masks = SWITCHED if number < 3 else (0, *ALL) if number % 10 == 0 else ALL
            yield self.shot(number, masks, stamp_s)
            stamp_s += FRAME_S * (1 + len(masks))


@lru_cache(maxsize=2)
def rendered_frames(light: str) -> Frames:
    """Frames in one of `LIGHTS`: the ring faces the camera of the example's full rig at 0.5 m."""
    scene = read_scene(FULL_SCENE)
    view = render_ring_view(scene, replace(scene.views[0], light=LIGHTS[light]), 0)
    of_mask = {
        mask: np.stack([view.frame(mask, scene.exposure_s, 0.0).image for _ in range(NOISES)])
        for mask in sorted({*ALL, *SWITCHED})
    }
    return Frames(rig=scene.rig, exposure_s=scene.exposure_s, of_mask=of_mask)
