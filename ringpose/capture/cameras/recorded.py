"""`files:`: shots and images taken earlier, as if they were taken now."""

from collections.abc import Sequence

import numpy as np

from ringpose.errors import DataError
from ringpose.types.arrays import Array, UInt8
from ringpose.types.image import ALL_LASERS, Shot, shot_with_frames
from ringpose.types.sequence import MAX_LASERS, Step


class Recording:
    """Takes what was recorded, one by one, and gives it back by the steps of a sequence.

    A shot keeps its name and gives its frames with the masks of the steps. Plain images know no masks: as many
    consecutive ones as there are steps make a shot under the name of the first. Without steps all stays as it is.
    """

    def __init__(self, steps: Sequence[Step] | None) -> None:
        self._steps = steps
        self._images: list[Shot] = []

    def taken(self, shot: Shot) -> Shot | None:
        """The next shot; None while images are still to come. A `DataError` concerns this one alone."""
        if self._steps is None:
            return shot
        if not _is_image(shot):
            return frames_of_steps(shot, self._steps)
        self._images.append(shot)
        if len(self._images) < len(self._steps):
            return None
        images, self._images = self._images, []
        return shot_of_images(images, self._steps)

    def end(self) -> None:
        """Images left over, too few for a shot, are bad data."""
        if self._images:
            found = f"{len(self._images)} of {len(self._steps or ())} images for a last shot"
            raise DataError(self._images[0].name, found, "check --sequence")


def frames_of_steps(shot: Shot, steps: Sequence[Step]) -> Shot:
    """The frames with the masks of the steps, in their order; a step met again takes the next such frame."""
    count = int(np.bitwise_or.reduce(shot.lasers)).bit_length()
    masks = [_mask(step, count) for step in steps]
    chosen = np.array([_frame(shot, steps, masks, place) for place in range(len(steps))], dtype=np.int64)
    return shot_with_frames(shot, chosen)


def shot_of_images(images: Sequence[Shot], steps: Sequence[Step]) -> Shot:
    """One shot of plain images, one a step, all of one size and depth."""
    first = images[0]
    for image in images:
        if image.images.shape != first.images.shape or image.images.dtype != first.images.dtype:
            raise DataError(image.name, f"differs from {first.name} in size or depth", "one shot is of one camera")
    return Shot(
        name=first.name,
        images=np.concatenate([image.images for image in images]),
        lasers=np.array([ALL_LASERS if step.text == "all" else step.mask(MAX_LASERS) for step in steps], np.uint8),
        stamp_s=np.concatenate([image.stamp_s for image in images]),
        exposure_s=np.concatenate([image.exposure_s for image in images]),
        meta={**first.meta, "images": [image.name for image in images]},
    )


def _is_image(shot: Shot) -> bool:
    return bool(len(shot.lasers) == 1 and shot.lasers[0] == ALL_LASERS)


def _mask(step: Step, count: int) -> int:
    """The mask of a step; `all` is every laser that the shot knows, and none of them is no mask at all."""
    if step.text == "all":
        return step.mask(count) or -1
    return step.mask(MAX_LASERS)


def _frame(shot: Shot, steps: Sequence[Step], masks: Sequence[int], place: int) -> int:
    there = np.flatnonzero(shot.lasers.astype(np.int64) == masks[place])
    earlier = list(masks[:place]).count(masks[place])
    if earlier >= len(there):
        found = "no frame" if not len(there) else f"only {len(there)} of {earlier + 1} frames"
        raise DataError(shot.name, f"{found} with lasers {steps[place].text}; its frames: {_names(shot.lasers)}")
    return int(there[earlier])


def _names(lasers: UInt8[Array, "frame"]) -> str:
    """Masks in the words of a sequence."""
    lit = [[str(bit + 1) for bit in range(MAX_LASERS) if mask >> bit & 1] for mask in lasers.tolist()]
    return ",".join("+".join(numbers) or "off" for numbers in lit)
