"""How far the break points are from where a pose predicts them."""

import numpy as np

from ringpose.kernels.forms import ClosedForm
from ringpose.kernels.misfit import Sights, misfit_px
from ringpose.types.break_points import BreakPoints
from ringpose.types.rig import Rig
from ringpose.types.ring_points import RingPoints


def prediction_rms_px(form: ClosedForm, points: RingPoints, break_points: BreakPoints, rig: Rig) -> float:
    """Root mean square distance between seen and predicted break points, in (distorted) pixels.

    A predicted one is where ring plane, light plane and the sphere of the edge's radius about the centre meet (the
    ring's circle itself where the centre lies in the plane); where the light plane misses the sphere, the line's
    point nearest to the centre. NaN if that does not exist in front of the camera. `form` is a batch of one.
    """
    laser, edge = np.nonzero(points.seen)
    sights = Sights(
        points.position_m[laser, edge], edge, rig.lasers.normal[laser], break_points.position_px[laser, edge]
    )
    return misfit_px(sights, form, rig.camera)
