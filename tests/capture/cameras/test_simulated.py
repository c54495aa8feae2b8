"""The simulated camera shows the lasers that are on, and advances to the next view when it is armed."""

import numpy as np
import pytest

from ringpose.capture.cameras.driver import CameraDescription
from ringpose.capture.cameras.simulated import SimulatedCamera, SimulatedLasers
from ringpose.capture.lasers.driver import LasersWentOff
from ringpose.capture.lasers.uncontrolled import UncontrolledLasers, reject_switching
from ringpose.capture.pipeline import Procedure, captured_shots
from ringpose.errors import UsageError
from ringpose.types.image import Frame
from ringpose.types.session import parsed_sequence

DESCRIPTION = CameraDescription(name="scene", image_width=3, image_height=2, saturation_dn=255)


def scene_frame(moment: int, lasers: int, exposure_s: float | None) -> Frame:
    """An image of value 10 * moment + mask."""
    image = np.full((2, 3), 10 * moment + lasers, dtype=np.uint8)
    return Frame(image=image, lasers=lasers, stamp_s=float(moment), exposure_s=exposure_s or 0.01)


def test_each_shot_shows_the_next_view_of_the_scene():
    lasers = SimulatedLasers(3)
    camera = SimulatedCamera(DESCRIPTION, scene_frame, lasers)

    with camera, lasers:
        shots = list(captured_shots(camera, lasers, Procedure(steps=parsed_sequence("off,1,all")), ["a", "b"]))

    assert [shot.images[:, 0, 0].tolist() for shot in shots] == [[0, 1, 7], [10, 11, 17]]


def test_a_repeated_shot_shows_the_same_view():
    class WentOff(SimulatedLasers):
        failures = 1

        def set_mask(self, lasers: int) -> None:
            super().set_mask(lasers)
            if lasers and self.failures:
                self.failures -= 1
                raise LasersWentOff("lasers", "went off")

    lasers = WentOff(3)
    camera = SimulatedCamera(DESCRIPTION, scene_frame, lasers)

    with camera, lasers:
        shots = list(captured_shots(camera, lasers, Procedure(steps=parsed_sequence("off,1,all")), ["a", "b"]))

    assert [shot.images[:, 0, 0].tolist() for shot in shots] == [[0, 1, 7], [10, 11, 17]]


def test_the_image_shows_the_lasers_that_are_on():
    class Stuck(SimulatedLasers):
        def read_mask(self) -> int | None:
            return 0b100

    camera = SimulatedCamera(DESCRIPTION, scene_frame, Stuck(3))

    camera.arm(None)
    frame = camera.trigger(0)

    assert frame.image[0, 0] == 0b100
    assert frame.lasers == 0


def test_uncontrolled_lasers_are_on_in_every_image():
    lasers = UncontrolledLasers(3)
    camera = SimulatedCamera(DESCRIPTION, scene_frame, lasers)

    (shot,) = captured_shots(camera, lasers, Procedure(steps=parsed_sequence("all")), ["a"])

    assert shot.images[0, 0, 0] == 7


def test_uncontrolled_lasers_cannot_be_switched_off():
    with pytest.raises(UsageError, match='step "off"'):
        reject_switching(parsed_sequence("off,all"))
