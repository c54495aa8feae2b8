"""Bent sheets of light: points on them, their tangent planes, and derivatives by what describes the bend."""

from dataclasses import replace

import numpy as np
import pytest
from bent_sheets import bent_rig, elevation_m
from ring_scenes import PROJECTED

from ringpose.geometry.rays import intersect
from ringpose.geometry.sheets import bends, bends_in_planes, bends_of, light_normals, light_planes, sheet_points
from ringpose.types.rig import BOW_PARAMETERS

LASER = np.repeat([0, 1, 2], 5)
RAYS = np.column_stack(
    [
        np.tile(np.linspace(-0.4, 0.4, 5), 3),
        (PROJECTED.distance_m[LASER] / 0.5 - PROJECTED.normal[LASER, 2]) / PROJECTED.normal[LASER, 1],
        np.ones(15),
    ]
)
"""Rays that meet the planes at a depth of 0.5 m."""


def test_rays_meet_the_bent_sheets_of_their_lasers():
    rig = bent_rig()

    points_m = sheet_points(RAYS, LASER, rig)

    for laser in range(3):
        np.testing.assert_allclose(elevation_m(points_m[laser == LASER], laser, rig), 0.0, atol=1e-10)
    np.testing.assert_allclose(points_m / points_m[:, 2:], RAYS, atol=1e-15)


def test_flat_sheets_are_their_planes():
    rig = replace(bent_rig(), bows={})
    normal, distance_m = PROJECTED.normal[LASER], PROJECTED.distance_m[LASER]

    assert bends_of(rig) is None
    np.testing.assert_array_equal(sheet_points(RAYS, LASER, rig), intersect(RAYS, normal, distance_m))
    for own, given in zip(light_planes(RAYS, LASER, rig), (normal, distance_m), strict=True):
        np.testing.assert_array_equal(own, given)


def test_a_projector_that_is_not_known_counts_as_the_cameras_centre():
    rig = bent_rig()
    unknown, there = (
        replace(rig, lasers=replace(PROJECTED, projector_m=np.full((3, 3), place))) for place in (np.nan, 0.0)
    )

    np.testing.assert_array_equal(sheet_points(RAYS, LASER, unknown), sheet_points(RAYS, LASER, there))


def test_beside_a_ray_a_sheet_deviates_from_its_tangent_plane_by_the_square_of_the_distance():
    rig = bent_rig()
    normal, distance_m = light_planes(RAYS, LASER, rig)
    np.testing.assert_allclose(light_normals(sheet_points(RAYS, LASER, rig), LASER, rig), normal, atol=1e-15)

    beside = [RAYS + step * np.array([1.0, 0.3, 0.0]) for step in (0.002, 0.004)]
    near, far = (np.abs(intersect(rays, normal, distance_m) - sheet_points(rays, LASER, rig))[:, 2] for rays in beside)

    bent = LASER != 1
    assert far[~bent].max() < 1e-13
    assert (far[bent] > 1e-8).all()
    np.testing.assert_allclose(far[bent] / near[bent], 4.0, rtol=0.15)


def test_a_ray_that_misses_its_sheet_has_the_flat_plane():
    away = np.array([[0.1, 0.5, 1.0]])

    normal, distance_m = light_planes(away, np.array([0]), bent_rig())

    assert np.isnan(sheet_points(away, np.array([0]), bent_rig())).all()
    np.testing.assert_array_equal(normal[0], PROJECTED.normal[0])
    assert distance_m[0] == PROJECTED.distance_m[0]


@pytest.mark.parametrize("parameter", range(len(BOW_PARAMETERS)))
def test_elevations_have_the_derivatives_of_central_differences(parameter):
    bow = np.array([[0.0114, 0.02, -0.03], [0.0, 0.01, 0.0], [-0.008, -0.03, 0.01]])
    points_m = sheet_points(RAYS, LASER, bent_rig())
    step = np.zeros_like(bow)
    step[:, parameter] = 1e-4

    there, back = (
        bends_in_planes(PROJECTED.normal, bow + sign * step).of(LASER).height_m(points_m) for sign in (1, -1)
    )

    analytic = bends_in_planes(PROJECTED.normal, bow).of(LASER).wrt_parameters(points_m)[:, parameter]
    np.testing.assert_allclose(analytic, (there - back) / 2e-4, rtol=1e-6, atol=1e-9)


def test_the_parameters_of_a_bend_are_those_that_it_was_made_of():
    bow = np.array([[0.0114, 0.02, -0.03], [0.0, 0.01, 0.0], [-0.008, -0.03, 0.01]])

    own = bends_in_planes(PROJECTED.normal, bow)

    np.testing.assert_allclose(own.parameters, bow, atol=1e-15)
    again = bends(PROJECTED.normal, own.per_rad, own.projector_m + PROJECTED.distance_m[:, None] * PROJECTED.normal)
    np.testing.assert_allclose(again.parameters, bow, atol=1e-15)
