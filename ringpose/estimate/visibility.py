"""Which lasers' stripes and break points should be in view by rig and ring."""

import numpy as np

from ringpose.estimate.hypotheses import Explanation
from ringpose.estimate.solver import ALARM_SIGMAS
from ringpose.estimate.stripe_evidence import single_stripe_estimates
from ringpose.geometry.rays import project
from ringpose.geometry.ring import EDGE_SIGN, RingArcs, edge_distances, predicted_break_points, predicted_stripes
from ringpose.optics.feature_errors import CUT_OFF_PX
from ringpose.types.arrays import Array, Bool, Float64
from ringpose.types.rig import Rig


def expected_in_view(best: Explanation, rig: Rig) -> tuple[Bool[Array, "laser edge=2"], Float64[Array, "laser"]]:
    """Which break points should be in the image, and the share of each stripe's length on the face that should be.

    That is where they are predicted farther than `ALARM_SIGMAS` from the border, where the detector may miss them.
    """
    arcs = best.estimate.arcs
    if arcs.curvature < 0:
        arcs = arcs.with_center_opposite()
    with np.errstate(all="ignore"):
        points_m = predicted_break_points(arcs, rig.lasers.normal, rig.lasers.distance_m)
        sigma_px = break_point_sigmas_px(arcs, best.estimate.inverse, points_m, rig).reshape(len(points_m), -1)
        margin_px = CUT_OFF_PX + ALARM_SIGMAS * sigma_px.max(axis=1)
    distance_px = _distance_inside_px(points_m, rig)
    inside = distance_px > margin_px[:, None]  # false for NaN
    share: Float64[Array, "laser"] = np.maximum(inside.mean(axis=1), _share_by_single_stripes(best, rig))
    return inside[:, [0, -1]], share


def _share_by_single_stripes(best: Explanation, rig: Rig) -> Float64[Array, "laser"]:
    """Share of each stripe that is in view as predicted by each of two stripes alone; 0 with other numbers of stripes.

    If one of two stripes does not lie on the ring, their common ring may predict the missing one outside the image.
    """
    share = np.zeros(len(rig.lasers.names))
    for _, _, estimate in single_stripe_estimates(best.measured, best.prior.assumptions):
        points_m = predicted_break_points(estimate.arcs, rig.lasers.normal, rig.lasers.distance_m)
        distance_px = _distance_inside_px(points_m, rig)
        share = np.maximum(share, (distance_px > CUT_OFF_PX).mean(axis=1))
    return share


def _distance_inside_px(points_m: Float64[Array, "laser edge=2 xyz=3"], rig: Rig) -> Float64[Array, "laser sample"]:
    """Distance from the image's border, positive inside, of points along each stripe between its break points."""
    samples = points_m[:, :1] + np.linspace(0.0, 1.0, 11)[:, None] * (points_m[:, 1:] - points_m[:, :1])
    size_px = np.array([rig.camera.image_width, rig.camera.image_height]) - 1.0
    pixels = project(samples, rig.camera)
    distance_px: Float64[Array, "laser sample"] = np.minimum(pixels, size_px - pixels).min(axis=-1)
    return distance_px


def break_point_sigmas_px(
    arcs: RingArcs,
    covariance: Float64[Array, "step=7 step=7"],
    points_m: Float64[Array, "laser edge=2 xyz=3"],
    rig: Rig,
) -> Float64[Array, "laser edge=2 xy=2"]:
    """Standard deviations of predicted break points by the ring's covariance: along the stripe (x), across it (y)."""
    rays = (points_m / points_m[..., 2:]).reshape(-1, 3)
    normal, distance_m = (np.repeat(each, 2, axis=0) for each in (rig.lasers.normal, rig.lasers.distance_m))
    stripes = predicted_stripes(arcs, rays[:, 0], normal, distance_m)
    edges = edge_distances(arcs, rays, np.tile(EDGE_SIGN, len(points_m)))
    along_wrt_step = edges.wrt_step + edges.wrt_ray[:, 1:] * stripes.y_wrt_step
    rate = edges.wrt_ray[:, 0] + stripes.slope * edges.wrt_ray[:, 1]
    sigma_y = np.sqrt(((stripes.y_wrt_step @ covariance) * stripes.y_wrt_step).sum(axis=1))
    sigma_x = np.sqrt(((along_wrt_step @ covariance) * along_wrt_step).sum(axis=1)) / np.abs(rate)
    sigma_px: Float64[Array, "point xy=2"] = (
        np.stack([sigma_x, sigma_y], axis=1) * rig.camera.camera_matrix[[0, 1], [0, 1]]
    )
    return sigma_px.reshape(-1, 2, 2)
