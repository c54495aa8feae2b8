"""Recorded shots and images rearranged to the steps of a sequence."""

import numpy as np
import pytest
from recorded_shots import counted, make_shot

from ringpose.capture.cameras.recorded import Recording, frames_of_steps
from ringpose.errors import DataError
from ringpose.types.image import ALL_LASERS, Shot
from ringpose.types.session import parsed_sequence


def image(name: str, value: int = 0, width: int = 3) -> Shot:
    pixels = np.full((1, 2, width), value, dtype=np.uint8)
    return make_shot(pixels, [ALL_LASERS], name=name, start_s=value)


def test_frames_are_selected_by_the_masks_of_the_steps():
    shot = counted([0, 1, 2, 4, 7], frame_id=np.arange(40, 45), name="kept")

    chosen = frames_of_steps(shot, parsed_sequence("all,off,2"))

    assert chosen.name == "kept"
    assert chosen.lasers.tolist() == [7, 0, 2]
    assert chosen.images[:, 0, 0].tolist() == [4, 0, 2]
    assert chosen.stamp_s.tolist() == [4.0, 0.0, 2.0]
    assert chosen.frame_id is not None
    assert chosen.frame_id.tolist() == [44, 40, 42]


def test_a_repeated_step_takes_the_next_frame_with_its_mask():
    chosen = frames_of_steps(counted([0, 1, 0]), parsed_sequence("off,1,off"))

    assert chosen.images[:, 0, 0].tolist() == [0, 1, 2]


def test_one_dark_frame_is_not_used_for_two_steps():
    with pytest.raises(DataError, match="only 1 of 2 frames with lasers off"):
        frames_of_steps(counted([0, 1]), parsed_sequence("off,1,off"))


def test_a_shot_in_the_dark_has_no_frame_with_all_lasers_on():
    with pytest.raises(DataError, match="no frame with lasers all"):
        frames_of_steps(counted([0, 0]), parsed_sequence("all"))


def test_images_of_two_sizes_are_bad_data():
    recording = Recording(parsed_sequence("off,all"))
    recording.taken(image("small"))

    with pytest.raises(DataError, match="wide: differs from small"):
        recording.taken(image("wide", width=4))
