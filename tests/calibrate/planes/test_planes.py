"""Light planes from exact, noisy and degenerate views."""

from dataclasses import replace

import numpy as np
import pytest
from calibrated import chi_squared
from known_views import PROJECTOR_M, TRUE_CAMERA, plane_errors, stripe_views, true_poses
from scipy.stats import chi2

from ringpose.calibrate.camera.parameters import camera_with, parameters_of
from ringpose.calibrate.planes.pipeline import PlanesModel, calibrate_planes
from ringpose.calibrate.planes.plane_fit import paper_plane, robust_plane
from ringpose.errors import DataError
from ringpose.types.options import PlanesMethod
from ringpose.types.rig import ParameterCovariance, bow_parameters, camera_parameters, laser_parameters

NAMES = ("left", "middle", "right")
MODEL = PlanesModel(names=NAMES)
PAPER = replace(MODEL, method=PlanesMethod.PAPER)
SEPARATE = replace(MODEL, method=PlanesMethod.TOTAL_LEAST_SQUARES)
NOTHING = np.empty((0, 2))


@pytest.mark.parametrize("model", [MODEL, PAPER], ids=lambda model: model.method.value)
@pytest.mark.parametrize("number", [3, pytest.param(6, marks=pytest.mark.slow)])
def test_exact_views_give_the_exact_planes(model, number, rng):
    found = calibrate_planes(stripe_views(true_poses(rng, number), rng), TRUE_CAMERA, model)

    assert np.abs(plane_errors(found)).max() < 1e-5
    assert max(laser.rms_m for laser in found.lasers) < 1e-7


def bent_errors(found, true_per_rad):
    """Errors of the parameters that the covariance names: planes, bows, and projectors in their planes."""
    errors = dict(zip(laser_parameters(NAMES), plane_errors(found), strict=True))
    for laser, name in enumerate(NAMES):
        if name in found.bows:
            normal = found.planes.normal[laser]
            axis = np.array([0.0, 0.0, 1.0]) - normal[2] * normal
            axis /= np.linalg.norm(axis)
            off_m = PROJECTOR_M - found.planes.projector_m[laser]
            wrong = (true_per_rad[laser] - found.bows[name].per_rad, off_m @ np.cross(normal, axis), off_m @ axis)
            errors |= dict(zip(bow_parameters([name]), wrong, strict=True))
    return np.array([errors[name] for name in found.covariance.parameters])


def test_bent_light_planes_are_measured_with_their_projectors_and_flat_ones_are_not_bent(rng):
    true, draws, chi2s = np.array([0.0114, 0.0, -0.009]), 4, []
    for _ in range(draws):
        views = stripe_views(true_poses(rng, 6), rng, corner_px=0.02, center_px=0.15, bow_per_rad=true)

        found = calibrate_planes(views, TRUE_CAMERA, MODEL)

        assert set(found.bows) == {"left", "right"}
        errors = bent_errors(found, true)
        chi2s.append(errors @ np.linalg.solve(found.covariance.data, errors))
        for name, bow in found.bows.items():
            assert bow.sd_per_rad == found.covariance.standard_deviations[f"{name}.bow"] < 0.002
    low, high = chi2.ppf([5e-4, 1 - 5e-4], draws * len(errors))
    assert low < np.sum(chi2s) < high
    assert np.isnan(found.planes.projector_m[1]).all()
    assert max(laser.rms_m for laser in found.lasers) < 1e-4
    assert max(laser.held_out_rms_m for laser in found.lasers) < 2e-4
    assert not calibrate_planes(views[:2], TRUE_CAMERA, MODEL).bows


def test_without_a_joint_adjustment_bends_are_about_the_camera(rng):
    true = np.array([0.0114, 0.0, -0.004])
    views = stripe_views(true_poses(rng, 6), rng, corner_px=0.02, center_px=0.15, bow_per_rad=true)

    found = calibrate_planes(views, TRUE_CAMERA, SEPARATE)

    assert set(found.bows) == {"left", "right"}
    errors = [(bow.per_rad - true[NAMES.index(name)]) / bow.sd_per_rad for name, bow in found.bows.items()]
    assert np.abs(errors).max() < 4.0
    assert np.isnan(found.planes.projector_m).all()
    flat = calibrate_planes(
        stripe_views(true_poses(rng, 6), rng, corner_px=0.02, center_px=0.15), TRUE_CAMERA, SEPARATE
    )
    assert max(laser.rms_m for laser in found.lasers) < 1.5 * max(laser.rms_m for laser in flat.lasers)


def test_a_lens_that_may_bend_the_stripes_as_much_leaves_a_bend_open(rng):
    views = stripe_views(true_poses(rng, 5), rng, center_px=0.15, bow_per_rad=[0.002, 0.002, 0.002])
    names = camera_parameters(5)
    loose = ParameterCovariance(parameters=names, data=np.diag([0.1, 0.1, 0.1, 0.1, 0.1, 0.1, 0.01, 0.01, 0.1]) ** 2)

    assert len(calibrate_planes(views, TRUE_CAMERA, SEPARATE).bows) == 3
    assert not calibrate_planes(views, replace(TRUE_CAMERA, covariance=loose), SEPARATE).bows


def test_two_parallel_boards_at_two_depths_suffice(rng):
    facing = [(np.eye(3), np.array([-0.15, -0.12, depth])) for depth in (0.45, 0.55)]

    found = calibrate_planes(stripe_views(facing, rng), TRUE_CAMERA, MODEL)

    assert np.abs(plane_errors(found)).max() < 1e-5


def test_views_on_one_line_are_rejected_with_the_views_to_add(rng):
    with pytest.raises(DataError, match="two or more distances"):
        calibrate_planes([], TRUE_CAMERA, MODEL)
    (pose,) = true_poses(rng, 1)
    with pytest.raises(DataError, match=r"one line.*add a view of the board 50 mm or more nearer or farther"):
        calibrate_planes(stripe_views([pose], rng), TRUE_CAMERA, MODEL)
    with pytest.raises(DataError, match="3 views lie on one line"):
        calibrate_planes(stripe_views(3 * [pose], rng, 0.02, 0.05), TRUE_CAMERA, MODEL)


UNSEEN = {
    "never seen": ({0, 1, 2}, 2, {}, 'laser "right": no stripe on the board in any of the 4 shots whose frames have'),
    "never on": ({0, 1}, 2, {}, 'laser "right": on in no frame of any shot; light it'),
    "fewer stripes": (
        {0, 1, 2},
        0,
        {"max_stripes": 2},
        "no frame shows more than 2 stripes on the board, there are 3 lasers: left, mid",
    ),
    "no stripe": (set(), 0, {}, "no frame shows more than 0 stripes on the board, there are 3 lasers"),
}


@pytest.mark.parametrize(("lit", "seen", "changes", "finding"), UNSEEN.values(), ids=UNSEEN)
def test_lasers_without_stripes_are_named(lit, seen, changes, finding, rng):
    views = [
        replace(view, stripes_px=(*view.stripes_px[:seen], *(3 - seen) * [NOTHING]), lit=frozenset(lit), **changes)
        for view in stripe_views(true_poses(rng, 4), rng)
    ]
    model = replace(MODEL, order=(2, 1, 0)) if changes else MODEL

    with pytest.raises(DataError, match=finding):
        calibrate_planes(views, TRUE_CAMERA, model)


def test_a_laser_that_is_seen_once_is_named(rng):
    views = stripe_views(true_poses(rng, 4), rng)
    hidden = [views[0], *(replace(view, stripes_px=(*view.stripes_px[:2], NOTHING)) for view in views[1:])]

    with pytest.raises(DataError, match='laser "right"'):
        calibrate_planes(hidden, TRUE_CAMERA, MODEL)


def test_stripes_without_a_common_plane_are_rejected(rng):
    first, *others = stripe_views(true_poses(rng, 3), rng)
    mixed = [replace(first, stripes_px=first.stripes_px[2:])]
    mixed += [replace(view, stripes_px=view.stripes_px[:1]) for view in others]

    with pytest.raises(DataError, match="lie on no common plane"):
        calibrate_planes(mixed, TRUE_CAMERA, PlanesModel(names=("red",)))


def test_a_stripe_beside_its_plane_is_left_out_by_name(rng):
    views = stripe_views(true_poses(rng, 6), rng, 0.02, 0.05)
    views[2] = replace(views[2], stripes_px=(views[2].stripes_px[0] + [0.0, 8.0], *views[2].stripes_px[1:]))

    found = calibrate_planes(views, TRUE_CAMERA, MODEL)

    assert [(name, reason[:23]) for name, reason in found.remarks] == [("v2", "stripe of left left out")]
    assert np.abs(plane_errors(found)).max() < 1e-3


def unlabelled(view, order):
    return replace(view, stripes_px=(NOTHING,) * 3, unlabelled_px=tuple(view.stripes_px[laser] for laser in order))


def test_stripes_seen_together_are_assigned_by_the_planes_of_the_other_views(rng):
    views = stripe_views(true_poses(rng, 6), rng, 0.02, 0.05)
    mixed = [*views[:3], *(unlabelled(view, (2, 1, 0)) for view in views[3:])]

    found = calibrate_planes(mixed, TRUE_CAMERA, MODEL)

    assert [len(laser.views) for laser in found.lasers] == [6, 6, 6]
    assert np.abs(plane_errors(found)).max() < 1e-3


def test_stripes_seen_together_are_labelled_by_their_order(rng):
    together = [unlabelled(view, (2, 1, 0)) for view in stripe_views(true_poses(rng, 3), rng)]

    with pytest.raises(DataError, match="--laser-order"):
        calibrate_planes(together, TRUE_CAMERA, MODEL)
    found = calibrate_planes(together, TRUE_CAMERA, replace(MODEL, order=(2, 1, 0)))
    assert np.abs(plane_errors(found)).max() < 1e-5


def test_held_out_error_is_unknown_with_two_views(rng):
    found = calibrate_planes(stripe_views(true_poses(rng, 2), rng, 0.02, 0.05), TRUE_CAMERA, MODEL)

    assert np.isnan([laser.held_out_rms_m for laser in found.lasers]).all()


def test_the_joint_covariance_contains_that_of_the_camera(rng, camera_covariance):
    camera = replace(TRUE_CAMERA, covariance=camera_covariance)

    views = stripe_views(true_poses(rng, 5), rng, 0.02, 0.05)

    found = calibrate_planes(views, camera, MODEL)

    count = len(camera_covariance.parameters)
    assert found.covariance.parameters[:count] == camera_covariance.parameters
    assert found.covariance.data[:count, :count] == pytest.approx(camera_covariance.data)
    assert np.linalg.eigvalsh(found.covariance.data).min() > -1e-12
    assert np.abs(found.covariance.data[:count, count:]).max() > 0
    assert found.camera is camera
    assert calibrate_planes(views, camera, PAPER).covariance is None


@pytest.mark.slow
@pytest.mark.parametrize("free_camera", [False, True])
def test_errors_of_calibrations_have_the_joint_covariance_that_is_reported(free_camera, rng, camera_covariance):
    """Every run has a camera drawn from its covariance, new noise and new boards."""
    runs = 20
    normalised = []
    for _ in range(runs):
        wrong = rng.multivariate_normal(np.zeros(9), camera_covariance.data)
        camera = wrong_camera(TRUE_CAMERA, wrong, camera_covariance)
        views = stripe_views(true_poses(rng, 7), rng, 0.05, 0.1)
        found = calibrate_planes(views, camera, replace(MODEL, free_camera=free_camera))
        error = plane_errors(found)
        normalised.append(error @ np.linalg.solve(found.covariance.data[9:, 9:], error))

    low, high = chi_squared([0.025, 0.975], 9 * runs)
    assert low < np.sum(normalised) < high


def wrong_camera(camera, wrong, covariance):
    return replace(camera_with(parameters_of(camera) + wrong, camera), covariance=covariance)


def test_a_free_camera_comes_nearer_to_the_truth(rng, camera_covariance):
    wide = replace(camera_covariance, data=100 * camera_covariance.data)
    camera = wrong_camera(TRUE_CAMERA, np.array([3.0, 3.0, 2.0, -2.0, 0, 0, 0, 0, 0]), wide)
    views = stripe_views(true_poses(rng, 5), rng, 0.01, 0.05)

    held = calibrate_planes(views, camera, MODEL)
    freed = calibrate_planes(views, camera, replace(MODEL, free_camera=True))

    assert np.abs(freed.camera.camera_matrix - TRUE_CAMERA.camera_matrix).max() < 0.7
    assert np.abs(plane_errors(freed)).max() < 0.5 * np.abs(plane_errors(held)).max()


def test_stripes_correct_boards_with_a_wrong_corner(rng):
    views = stripe_views(true_poses(rng, 6), rng, 0.01, 0.05)
    for index in range(6):
        moved = views[index].board.points_px + 0.4 * (np.arange(16) == index)[:, None]
        views[index] = replace(views[index], board=replace(views[index].board, points_px=moved))

    joint, separate = (calibrate_planes(views, TRUE_CAMERA, model) for model in (MODEL, SEPARATE))

    assert np.linalg.norm(plane_errors(joint)) < 0.6 * np.linalg.norm(plane_errors(separate))


def test_a_bent_board_widens_the_covariance(rng):
    poses = true_poses(rng, 6)
    flat = stripe_views(poses, rng, 0.02, 0.05)
    bent = [
        replace(view, stripes_px=tuple(px + np.array([0.0, 0.6 * np.sin(3.0 * index)]) for px in view.stripes_px))
        for index, view in enumerate(flat)
    ]

    found = [calibrate_planes(views, TRUE_CAMERA, MODEL) for views in (flat, bent)]

    assert found[0].excess == 1.0
    assert found[1].excess > 3.0


def test_the_laser_that_disagrees_stands_out(rng):
    views = stripe_views(true_poses(rng, 6), rng, 0.02, 0.05)
    views = [
        replace(view, stripes_px=(*view.stripes_px[:2], view.stripes_px[2] + [0.0, 0.5 * (-1.0) ** index]))
        for index, view in enumerate(views)
    ]

    found = calibrate_planes(views, TRUE_CAMERA, MODEL)

    disagreement = [laser.disagreement for laser in found.lasers]
    assert disagreement[2] > 3 * max(disagreement[:2])


@pytest.fixture
def camera_covariance() -> ParameterCovariance:
    sigma = np.array([0.15, 0.15, 0.2, 0.2, 4e-4, 2e-3, 2e-5, 2e-5, 0.0])
    names = ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3")
    return ParameterCovariance(parameters=names, data=np.diag(sigma**2))


def test_the_papers_plane_and_the_nearest_plane_agree_on_exact_points(rng):
    points = rng.uniform(-1, 1, (50, 3))
    points[:, 2] = 2 + 0.3 * points[:, 0] - 0.2 * points[:, 1]

    paper, nearest = paper_plane(points), robust_plane(points)

    assert np.abs(paper[0] - nearest[0]).max() < 1e-12
    assert paper[1] == pytest.approx(nearest[1], abs=1e-12)


def test_a_third_of_wrong_points_does_not_move_the_robust_plane(rng):
    points = rng.uniform(-1, 1, (300, 3)) * [1, 1, 0] + rng.normal(0, 1e-4, (300, 3)) + [0, 0, 2]
    points[:90, 2] += rng.uniform(0.01, 0.5, 90)

    normal, distance_m, _ = robust_plane(points)

    assert np.abs(normal - [0, 0, 1]).max() < 1e-4
    assert distance_m == pytest.approx(2, abs=1e-4)
