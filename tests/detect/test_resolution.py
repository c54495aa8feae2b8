"""The limits that the reason of a shot without a pose states, against the optics of the scene."""

import math
import re
from dataclasses import replace

import numpy as np
import pytest
from ring_scenes import PROJECTED, make_camera

from ringpose.detect.pipeline import detect
from ringpose.simulate.pipeline import simulate
from ringpose.types.detection import NoBreakPoints
from ringpose.types.rig import Rig
from ringpose.types.scene import Light, RingView, Scene, Sensor
from ringpose.types.target import Body, RingShape

RIG = Rig(camera=make_camera((800, 600), (889.0, 889.0), (400.0, 300.0)), lasers=PROJECTED)
DISTANCE_M = 0.7


def shot_of_a_low_ring(sequence: tuple[int, ...]):
    """A ring whose face is 2 mm before the body, half a pixel at this distance."""
    height_m = 0.002
    scene = Scene(
        rig=RIG,
        ring=RingShape(profile_m=np.array([[0.567, 0.0], [0.567, height_m], [0.597, height_m], [0.597, 0.0]])),
        body=Body(size_m=np.array([2.0, 2.0, 0.5])),
        lights={"dim": Light(name="dim")},
        sensor=Sensor(pixel_m=9e-6),
        exposure_s=0.001,
        stripe_dn=170.0,
        sequence=sequence,
        views=(RingView(name="v", center_m=np.array([-0.58, 0.0, DISTANCE_M]), normal=np.array([0.0, 0.0, -1.0])),),
    )
    (shot, _), *_ = simulate(scene)
    return shot, scene


def test_the_reason_states_the_height_and_width_from_which_a_face_is_seen():
    shot, scene = shot_of_a_low_ring((0, 1, 2, 4))

    detection = detect(shot, RIG)

    assert detection.break_points is NoBreakPoints.NO_RING
    stated = re.fullmatch(
        r"at ([\d.]+) m, where the stripes are, a face should be (\d+) mm in front of what lies behind it \(a step of "
        r"([\d.]+) px, the stripe's width(?:, the largest one here is ([\d.]+) px)?\) and (\d+) mm wide \(10 columns\)",
        detection.advice,
    )
    assert stated is not None, detection.advice
    distance_m, height_mm, step_px, largest_px, width_mm = map(float, stated.groups(default="nan"))
    light = scene.lasers
    section_px = 889.0 / DISTANCE_M * math.hypot(light.sigma_m, light.divergence_rad * DISTANCE_M)
    assert distance_m == pytest.approx(DISTANCE_M, rel=0.02)
    assert step_px == pytest.approx(2.355 * math.hypot(section_px, scene.lens.blur_px), rel=0.25)
    assert not largest_px > step_px
    assert width_mm == pytest.approx(10.0 * DISTANCE_M / 889.0 * 1e3, rel=0.1)
    offsets = np.abs(889.0 * RIG.lasers.distance_m / RIG.lasers.normal[:, 1])
    near_m = DISTANCE_M - 1e-3 * height_mm
    steps_px = offsets * (1.0 / near_m - 1.0 / DISTANCE_M)
    assert np.abs(steps_px - step_px).min() < 0.2


def test_no_limit_is_stated_where_no_laser_is_known():
    shot, _ = shot_of_a_low_ring((0, 7))

    detection = detect(shot, RIG)

    assert isinstance(detection.break_points, NoBreakPoints)
    assert "where the stripes are" not in detection.advice


@pytest.mark.parametrize(("share", "advised"), [(0.25, True), (0.5, False)])
def test_without_a_face_the_advice_names_a_laser_that_is_too_faint_beside_another(share, advised):
    shot, _ = shot_of_a_low_ring((0, 1, 2, 4))
    images = shot.images.copy()
    images[1] = np.rint(images[0] + share * (images[1].astype(np.float64) - images[0])).clip(0, 255)

    detection = detect(replace(shot, images=images), RIG)

    assert detection.break_points is NoBreakPoints.NO_RING
    phrase = re.search(r"the stripes of laser \S+ are (\S+) times as bright as those of (\S+):", detection.advice)
    assert (phrase is not None) is advised
    if phrase is not None:
        assert float(phrase[1]) == pytest.approx(1.0 / share, rel=0.25)
        assert phrase[2] == RIG.lasers.names[0]
