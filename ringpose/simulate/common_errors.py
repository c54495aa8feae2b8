"""Errors that all shots of a run have in common: of the rig's calibration, and of the ring's form."""

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from ringpose.errors import DataError
from ringpose.estimate.nuisance import FORM_ORDERS, form_sd_m, rig_errors
from ringpose.geometry.ring import RingArcs
from ringpose.geometry.rotations import tilted
from ringpose.types.arrays import Array, Float64, Int64
from ringpose.types.rig import Rig
from ringpose.types.target import RingForm


class CommonErrors(NamedTuple):
    """What all shots of a run have in common."""

    rig: Rig
    """The true rig."""
    form: RingForm


def drawn_common_errors(
    rig: Rig, rng: np.random.Generator, *, ring_tolerance_m: float = 0.0, with_rig_errors: bool = False
) -> CommonErrors:
    """True rig and form of the ring of a run, for a rig file that is `rig`.

    The form's deviations have the standard deviation `ring_tolerance_m` at any angle (ringpose-method(7), section 12).
    """
    # the form is drawn first, and also for a tolerance of 0: the rig does not depend on the tolerance
    scale_m = form_sd_m(ring_tolerance_m)
    form = RingForm(
        radial_m=scale_m * rng.standard_normal((2, len(FORM_ORDERS), 2)),
        axial_m=scale_m * rng.standard_normal((len(FORM_ORDERS), 2)),
    )
    return CommonErrors(drawn_rig(rig, rng) if with_rig_errors else rig, form)


def drawn_rig(rig: Rig, rng: np.random.Generator) -> Rig:
    """A random rig, drawn from the covariance and the stability of `rig`; it has no covariance itself."""
    errors = rig_errors(rig, rig.stability)
    if errors is None:
        raise DataError(
            "the scene's rig", "has neither covariance nor stability", "calibrate it, or do not draw rig errors"
        )
    drawn = errors.root @ rng.standard_normal(errors.root.shape[1])
    camera, planes = errors.camera @ drawn, errors.lasers @ drawn
    focal_x, focal_y, center_x, center_y = camera[:4].tolist()
    matrix = rig.camera.camera_matrix + np.array([[focal_x, 0, center_x], [0, focal_y, center_y], [0, 0, 0]])
    normals = [tilted(normal, plane[:2]) for normal, plane in zip(rig.lasers.normal, planes, strict=True)]
    return replace(
        rig,
        camera=replace(
            rig.camera,
            camera_matrix=matrix,
            distortion_coefficients=rig.camera.distortion_coefficients + camera[4:],
            covariance=None,
        ),
        lasers=replace(rig.lasers, normal=np.array(normals), distance_m=rig.lasers.distance_m + planes[:, 2]),
        covariance=None,
    )


FORM_STEPS = 3
"""Newton steps to the break points of a deviating ring; the last one is shorter than 1e-9 m."""


def form_displacement(
    form: RingForm,
    point_m: Float64[Array, "edge=2 xyz=3"],
    arcs: RingArcs,
    axes: Float64[Array, "3 3"],
    light_normal: Float64[Array, "xyz=3"],
) -> Float64[Array, "edge=2 xyz=3"]:
    """Displacement of a stripe's break points on the inner and the outer edge by the ring's form, by Newton's method.

    The points stay on the light plane. The columns of `axes` are the x, y and z axes of the ring.
    """
    in_plane = point_m - arcs.center
    radius_m = np.linalg.norm(in_plane, axis=1)
    displacement = np.zeros((2, 3))
    for _ in range(FORM_STEPS):
        place_m = in_plane + displacement
        height_m = place_m @ arcs.normal
        outward = place_m - height_m[:, None] * arcs.normal
        distance_m = np.linalg.norm(outward, axis=1)
        radial_m, axial_m = form_deviations(form, place_m @ axes, np.array([0, 1]))
        rows = np.stack(
            [
                np.broadcast_to(light_normal, (2, 3)),
                np.broadcast_to(arcs.normal, (2, 3)),
                outward / distance_m[:, None],
            ],
            axis=1,
        )
        values = np.stack([np.zeros(2), axial_m - height_m, radius_m + radial_m - distance_m], axis=1)
        displacement = displacement + np.linalg.solve(rows, values[..., None])[..., 0]
    return displacement


def form_deviations(
    form: RingForm, place_m: Float64[Array, "n xyz=3"], edge: Int64[Array, "n"]
) -> tuple[Float64[Array, "n"], Float64[Array, "n"]]:
    """Radial deviations of an edge and axial deviations of the face, at places in the ring's own axes."""
    phase = np.arctan2(place_m[:, 1], place_m[:, 0])[:, None] * np.array(FORM_ORDERS)
    waves = np.stack([np.cos(phase), np.sin(phase)], axis=-1)
    radial_m: Float64[Array, "n"] = (waves * form.radial_m[edge]).sum(axis=(1, 2))
    axial_m: Float64[Array, "n"] = (waves * form.axial_m).sum(axis=(1, 2))
    return radial_m, axial_m
