"""An external renderer shows the same stripes and the same brightness of ring and foil."""

import os
from dataclasses import replace

import numpy as np
import pytest

from ringpose.geometry.rays import project
from ringpose.simulate.pipeline import illuminated_ring
from ringpose.simulate.renderer import layers, pixel_rays
from ringpose.types.scene import LaserLight, Light, RingView
from ringpose.types.target import Body, Material, RingShape

pytestmark = pytest.mark.slow

FACE = Material(diffuse=0.45, specular=0.0, roughness=1.0)
FOIL = Material(diffuse=0.25, specular=0.0, roughness=1.0)
DIVERGENCE_RAD = 0.0024
"""Standard deviation of a sheet of light, as an angle at the projector."""

SUN = np.array([-0.5, -0.3, -0.8])
SEGMENTS = 4096


@pytest.fixture(scope="module")
def mitsuba():
    try:
        import mitsuba
    except ImportError:
        missing = "mitsuba is not installed (pip install 'ringpose[dev]')"
        pytest.fail(missing) if os.environ.get("CI") else pytest.skip(missing)
    mitsuba.set_variant("scalar_rgb")
    return mitsuba


@pytest.fixture
def facing(scene):
    """A pinhole camera that looks at the ring and at the body beside it; lasers and sun have no speckle or blur."""
    camera = replace(
        scene.rig.camera,
        distortion_coefficients=np.zeros(5),
        camera_matrix=np.array([[356.0, 0.0, 159.5], [0.0, 356.0, 119.5], [0.0, 0.0, 1.0]]),
    )
    return replace(
        scene,
        rig=replace(scene.rig, camera=camera),
        ring=RingShape(
            profile_m=np.array([[0.567, 0.0], [0.567, 0.06], [0.597, 0.06], [0.597, 0.0]]), face=FACE, wall=FACE
        ),
        body=Body(size_m=np.array([2.2, 2.2, 1.0]), material=FOIL),
        lasers=LaserLight(sigma_m=1e-6, divergence_rad=DIVERGENCE_RAD),
        lights={"sun": Light(name="sun", sun_w_m2=15.0, sun_direction=SUN, sun_diameter_rad=1e-6)},
    )


VIEW = RingView(
    name="a", center_m=np.array([-0.57, -0.05, 0.5]), normal=np.array([0.0, 0.1, -np.sqrt(0.99)]), light="sun"
)


def test_stripes_and_brightness_are_those_of_mitsuba(mitsuba, facing, tmp_path):
    """Centroids of the middle laser's stripe within 0.15 px, and the ratio of ring to body within 20 %."""
    illuminated = illuminated_ring(facing, VIEW)
    ours = layers(illuminated, pixel_rays(facing.rig.camera))
    target = shapes(facing, illuminated.placement, tmp_path / "ring.obj")

    lit, sunny = (render(mitsuba, facing.rig.camera, target, light) for light in (sheet(mitsuba, facing), sunlight()))

    bright = ours.laser[1].sum(axis=0)
    columns = np.flatnonzero((bright > 0.3 * bright.max()) & single(ours.laser[1]) & single(lit))
    apart_px = centroids(lit)[columns] - centroids(ours.laser[1])[columns]
    assert len(columns) > 150
    assert np.abs(apart_px).max() < 0.15
    face, foil = (pixels_at(facing, illuminated.placement, *place) for place in ((0.582, 0.06), (0.8, 0.0)))
    theirs = sunny[face].mean() / sunny[foil].mean()
    assert ours.ambient[face].mean() / ours.ambient[foil].mean() == pytest.approx(theirs, rel=0.2)


def pixels_at(scene, placement, radius_m, height_m):
    """Row and column of points at a radius about the ring's axis."""
    angle = np.linspace(-0.08, 0.08, 9)
    own = np.stack([radius_m * np.cos(angle), radius_m * np.sin(angle), np.full(9, height_m)], axis=1)
    column, row = project(placement.points_camera(own), scene.rig.camera).round().astype(int).T
    return row, column


def single(layer):
    """Columns whose light lies within a few rows: there is one stripe."""
    rows = np.arange(len(layer))[:, None]
    total = np.maximum(layer.sum(axis=0), 1e-12)
    spread2 = (layer * (rows - centroids(layer)) ** 2).sum(axis=0) / total
    return (total > 0.05 * total.max()) & (spread2 < 4.0)


def centroids(layer):
    rows = np.arange(len(layer))[:, None]
    return (layer.astype(float) * rows).sum(axis=0) / np.maximum(layer.sum(axis=0), 1e-12)


# The scene for mitsuba, in the camera frame


def shapes(scene, placement, path):
    """The ring as a mesh of `SEGMENTS` flat segments, and the body as a cube."""
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = placement.rotation, placement.translation_m
    angle = 2 * np.pi * np.arange(SEGMENTS) / SEGMENTS
    profile = scene.ring.profile_m
    points = [placement.points_camera(np.stack([r * np.cos(angle), r * np.sin(angle), np.full(SEGMENTS, z)], axis=1))
              for r, z in profile]  # fmt: skip
    lines = [f"v {x} {y} {z}" for x, y, z in np.concatenate(points).tolist()]
    for piece in range(len(profile) - 1):
        for k in range(SEGMENTS):
            low, high = piece * SEGMENTS + 1, (piece + 1) * SEGMENTS + 1
            after = (k + 1) % SEGMENTS
            lines.append(f"f {low + k} {low + after} {high + after} {high + k}")
    path.write_text("\n".join(lines) + "\n")
    half = scene.body.size_m / 2
    cube = pose @ np.diag([*half, 1.0]) + np.outer(pose[:, 2], [0, 0, 0, -half[2]])
    return {
        "ring": {"type": "obj", "filename": str(path), "face_normals": True, "bsdf": matt(FACE)},
        "body": {"type": "cube", "to_world": cube, "bsdf": matt(FOIL)},
    }


def matt(material):
    diffuse = {"type": "diffuse", "reflectance": {"type": "rgb", "value": material.diffuse}}
    return {"type": "twosided", "bsdf": diffuse}


def sunlight():
    return {"type": "directional", "direction": (-SUN).tolist(), "irradiance": {"type": "rgb", "value": 15.0}}


def sheet(mitsuba, scene):
    """A projector whose picture is the profile of the middle laser's sheet."""
    planes, rows, columns, half_width = scene.rig.lasers, 64, 2048, np.tan(np.radians(35.0))
    normal, origin = planes.normal[1], planes.projector_m[1]
    axis = np.array([0.0, 0.0, 1.0]) - normal[2] * normal
    offset = (np.arange(rows) - (rows - 1) / 2) * 2 * half_width / columns
    profile = np.exp(-0.5 * (offset / DIVERGENCE_RAD) ** 2).astype(np.float32)
    picture = np.ascontiguousarray(np.broadcast_to(profile[:, None, None], (rows, columns, 3)))
    return {
        "type": "projector",
        "irradiance": {"type": "bitmap", "bitmap": mitsuba.Bitmap(picture), "raw": True},
        "fov": 70.0,
        "to_world": mitsuba.ScalarTransform4f().look_at(
            origin=origin.tolist(), target=(origin + axis).tolist(), up=normal.tolist()
        ),
    }


def render(mitsuba, camera, target, light):
    width, height = camera.image_width, camera.image_height
    transform = mitsuba.ScalarTransform4f
    described = {name: dict(shape) for name, shape in target.items()}
    described["body"]["to_world"] = transform(target["body"]["to_world"])
    film = {"type": "hdrfilm", "width": width, "height": height, "pixel_format": "luminance",
            "component_format": "float32", "rfilter": {"type": "box"}}  # fmt: skip
    scene = mitsuba.load_dict({
        "type": "scene",
        "integrator": {"type": "direct"},
        "light": light,
        "sensor": {
            "type": "perspective",
            "fov": float(2 * np.degrees(np.arctan(width / 2 / camera.camera_matrix[0, 0]))),
            "to_world": transform().look_at(origin=[0, 0, 0], target=[0, 0, 1], up=[0, -1, 0]),
            "film": film,
            "sampler": {"type": "stratified", "sample_count": 16},
        },
        **described,
    })  # fmt: skip
    return np.array(mitsuba.render(scene))[..., 0]
