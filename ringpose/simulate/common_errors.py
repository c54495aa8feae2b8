"""Errors that all shots of a run have in common: of the rig's calibration, and of the ring's form."""

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from ringpose.errors import DataError
from ringpose.estimate.nuisance import FORM_ORDERS, FORM_SHARE, rig_errors
from ringpose.geometry.rotations import tilted
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
    scale_m = FORM_SHARE * ring_tolerance_m
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
