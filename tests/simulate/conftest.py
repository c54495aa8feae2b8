"""A small rig and scene for the tests of the renderer: 320 x 240 pixels."""

from dataclasses import replace

import numpy as np
import pytest
from ring_scenes import PROJECTED, make_camera

from ringpose.types.rig import Rig
from ringpose.types.scene import LaserLight, Light, Optics, RingView, Scene, Sensor, Speckle
from ringpose.types.target import Body, RingShape


@pytest.fixture(scope="session")
def small_rig():
    camera = make_camera((320, 240), (356.0, 356.4), (160.7, 119.2), (-0.105, 0.118, 0.00055, -0.0004, 0.0))
    return Rig(camera=camera, lasers=PROJECTED)


@pytest.fixture(scope="session")
def ring():
    return RingShape(profile_m=np.array([[0.567, 0.0], [0.567, 0.06], [0.597, 0.06], [0.597, 0.0]]))


@pytest.fixture(scope="session")
def view():
    return RingView(
        name="near", center_m=np.array([-0.57, -0.08, 0.47]), normal=np.array([0.0, 0.1, -np.sqrt(0.99)]), light="dim"
    )


@pytest.fixture(scope="session")
def scene(small_rig, ring, view):
    lights = {
        "dim": Light(name="dim"),
        "normal": Light(name="normal", ambient_w_m2=8.0),
        "strong": Light(name="strong", ambient_w_m2=0.5, sun_w_m2=15.0),
    }
    return Scene(
        rig=small_rig,
        ring=ring,
        body=Body(size_m=np.array([2.2, 2.2, 1.0])),
        lights=lights,
        sensor=Sensor(pixel_m=2.25e-5),
        exposure_s=0.0002,
        views=(view,),
        sequence=(0, 1, 2, 4, 7),
    )


@pytest.fixture(scope="session")
def clean_scene(scene):
    """The scene without speckle, blur and pixel non-uniformity, with light sheets of constant thickness."""
    return replace(
        scene,
        speckle=Speckle(contrast=0.0),
        lens=Optics(blur_px=0.0),
        sensor=replace(scene.sensor, photo_response_non_uniformity=0.0),
        lasers=LaserLight(sigma_m=0.0008, divergence_rad=0.0),
    )
