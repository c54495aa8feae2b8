"""`files:`: recorded shots and images, rearranged to the steps of a sequence."""

from collections.abc import Sequence

import numpy as np

from ringpose.errors import DataError
from ringpose.types.image import ALL_LASERS, Shot, shot_with_frames
from ringpose.types.session import MAX_LASERS, Step


class Recording:
    """Converts recorded shots and images, one by one, to shots with the steps of a sequence.

    From a recorded shot, the frames with the masks of the steps are selected, and its name is kept. Plain images have
    no masks: as many consecutive images as there are steps form a shot with the name of the first image. Without steps
    nothing is changed.
    """

    def __init__(self, steps: Sequence[Step] | None) -> None:
        self._steps = steps
        self._images: list[Shot] = []

    def taken(self, shot: Shot) -> Shot | None:
        """The next shot; None if more images are needed for it. A `DataError` concerns this input only."""
        if self._steps is None:
            return shot
        if len(shot.lasers) != 1 or shot.lasers[0] != ALL_LASERS:  # a shot, not a plain image
            return frames_of_steps(shot, self._steps)
        self._images.append(shot)
        if len(self._images) < len(self._steps):
            return None
        images, self._images = self._images, []
        return shot_of_images(images, self._steps)

    def end(self) -> None:
        """Check that no images are left over that are too few for a shot."""
        if self._images:
            finding = f"{len(self._images)} of {len(self._steps or ())} images for a last shot"
            raise DataError(self._images[0].name, finding, "check --sequence")


def frames_of_steps(shot: Shot, steps: Sequence[Step]) -> Shot:
    """The frames with the masks of the steps, in their order; a repeated step takes the next frame with its mask."""
    count = int(np.bitwise_or.reduce(shot.lasers)).bit_length()
    chosen: list[int] = []
    masks: list[int] = []
    for step in steps:
        # `all` means the lasers that occur in the shot, or without any -1, which matches no frame.
        mask = step.mask(count) or -1 if step.text == "all" else step.mask(MAX_LASERS)
        matching = np.flatnonzero(shot.lasers.astype(np.int64) == mask)
        earlier = masks.count(mask)
        if earlier >= len(matching):
            finding = "no frame" if not len(matching) else f"only {len(matching)} of {earlier + 1} frames"
            on = [[str(bit + 1) for bit in range(MAX_LASERS) if lasers >> bit & 1] for lasers in shot.lasers.tolist()]
            frames = ",".join("+".join(numbers) or "off" for numbers in on)
            raise DataError(shot.name, f"{finding} with lasers {step.text}; its frames: {frames}")
        chosen.append(int(matching[earlier]))
        masks.append(mask)
    return shot_with_frames(shot, np.array(chosen, dtype=np.int64))


def shot_of_images(images: Sequence[Shot], steps: Sequence[Step]) -> Shot:
    """One shot of plain images, one for each step, all of the same size and bit depth."""
    first = images[0]
    for image in images:
        if image.images.shape != first.images.shape or image.images.dtype != first.images.dtype:
            finding = f"differs from {first.name} in size or depth"
            raise DataError(image.name, finding, "all images of a shot must come from one camera")
    return Shot(
        name=first.name,
        images=np.concatenate([image.images for image in images]),
        lasers=np.array([ALL_LASERS if step.text == "all" else step.mask(MAX_LASERS) for step in steps], np.uint8),
        stamp_s=np.concatenate([image.stamp_s for image in images]),
        exposure_s=np.concatenate([image.exposure_s for image in images]),
        meta={**first.meta, "images": [image.name for image in images]},
    )
