from dataclasses import replace

import numpy as np
import pytest

from ringpose.geometry.rays import rays
from ringpose.simulate.pipeline import SceneFrames, illuminated_ring, simulate
from ringpose.simulate.placement import ring_views
from ringpose.simulate.renderer import render_view
from ringpose.types.scene import Approach, Beacon, Light


def images_of(scene, **options):
    return [shot.images for shot, _ in simulate(scene, **options)]


def test_the_seed_determines_the_images(scene):
    first, second, other = (images_of(each) for each in (scene, scene, replace(scene, seed=2)))

    np.testing.assert_array_equal(first, second)
    assert (first[0] != other[0]).mean() > 0.001


def test_processes_do_not_change_the_images(scene):
    several = replace(scene, views=(), approaches=(Approach(count=4, distances_m=(0.5,)),), sequence=(7,))

    one, two = images_of(several, jobs=1), images_of(several, jobs=2)

    np.testing.assert_array_equal(one, two)


def test_views_have_unique_names_and_count_takes_the_first(scene):
    several = replace(scene, approaches=(Approach(count=3),), sequence=(7,))

    names = [shot.name for shot, _ in simulate(several, count=2)]

    assert names == ["near", "z0500_p00_dim"]
    approach = Approach(count=4, distances_m=(0.25, 0.5), lights=("dim", "normal"))
    names = [view.name for view in ring_views(replace(scene, approaches=(approach,)))]
    assert len(set(names)) == len(names) == 17


def test_frames_follow_the_sequence_and_shots_of_twelve_bits_record_their_saturation(scene):
    ((shot, _),) = simulate(replace(scene, sensor=replace(scene.sensor, bits=12)))

    assert shot.lasers.tolist() == [0, 1, 2, 4, 7]
    assert (np.diff(shot.stamp_s) > shot.exposure_s[:-1]).all()
    assert (shot.images.dtype, shot.saturation_dn) == (np.uint16, 4095)


def test_lasers_add_up_and_light_grows_with_exposure(scene, view):
    stage = render_view(scene, illuminated_ring(scene, view), (1,))

    alone = [stage.electrons(mask, 0.001) for mask in (1, 2, 4)]

    np.testing.assert_allclose(stage.electrons(7, 0.001), sum(alone), rtol=1e-5, atol=1e-3)
    np.testing.assert_allclose(stage.electrons(7, 0.003), 3 * stage.electrons(7, 0.001), rtol=1e-5)


def test_a_beacon_adds_its_light_while_it_is_on(scene, view):
    beacon = Beacon(ambient_w_m2=3.0, on_s=0.3, off_s=0.6, phase_s=10.0)
    lights = {
        "blinking": Light(name="blinking", ambient_w_m2=5.0, beacon=beacon),
        "low": Light(name="low", ambient_w_m2=5.0),
        "high": Light(name="high", ambient_w_m2=8.0),
    }
    stands = [illuminated_ring(replace(scene, lights=lights), replace(view, light=light)) for light in lights]
    blinking, low, high = (render_view(scene, stand, (1,)) for stand in stands)

    for began_s, share in ((10.05, 1.0), (10.295, 0.5), (10.4, 0.0), (10.895, 0.5), (10.05 - 1e4 * 0.9, 1.0)):
        expected = (1 - share) * low.electrons(7, 0.01) + share * high.electrons(7, 0.01)
        np.testing.assert_allclose(blinking.electrons(7, 0.01, began_s), expected, rtol=2e-3, atol=1e-3)


def test_a_beacon_may_go_on_and_off_several_times_in_an_exposure():
    beacon = Beacon(ambient_w_m2=3.0, on_s=0.02, off_s=0.03)

    assert beacon.share_on(0.01, 0.12) == pytest.approx((0.01 + 0.02 + 0.02) / 0.12)


def test_exposure_reaches_the_requested_grey_value(clean_scene, view):
    """The peak of the brightest stripe on the face, within noise and the integration of the profile over pixels."""
    ((shot, truth),) = simulate(replace(clean_scene, stripe_dn=150.0, lens=replace(clean_scene.lens, blur_px=0.7)))

    peaks = []
    for laser, ends in enumerate(truth.break_points_px):
        first, last = np.sort(ends[:, 0]).astype(int)
        row = int(ends[:, 1].mean())
        peaks.append(shot.images[1 + laser][row - 4 : row + 5, first + 4 : last - 3].max(axis=0).mean())
    assert max(peaks) == pytest.approx(150, rel=0.15)


def test_a_view_without_the_ring_is_exposed_as_with_it(clean_scene, view):
    views = tuple(replace(view, name=target, target=target) for target in ("ring", "body", "none"))

    exposures_s = {shot.exposure_s[0] for shot, _ in simulate(replace(clean_scene, stripe_dn=150.0, views=views))}

    assert len(exposures_s) == 1


def test_a_moment_of_the_simulated_camera_equals_the_shot_of_the_view(scene):
    frames = SceneFrames(scene)
    ((shot, _),) = simulate(scene)

    taken = [frames(0, int(mask)).image for mask in shot.lasers]

    np.testing.assert_array_equal(taken, shot.images)
    first, second = (frames(0, 7, 0.0005).image for _ in range(2))
    assert (first != second).any()  # each frame has new noise


def test_the_clock_of_the_simulated_camera_advances(scene):
    frames = SceneFrames(replace(scene, approaches=(Approach(count=2),)))

    stamps = [frames(moment, 7).stamp_s for moment in (0, 0, 1, 2, 7)]

    assert (np.diff(stamps) > 0).all()


@pytest.mark.parametrize("distance_m", [0.25, 0.5, 1.0])
def test_random_poses_show_the_ring_at_their_distance(scene, distance_m):
    """The mean circle of the ring intersects the ray of a pixel near the image centre at that depth."""
    approach = Approach(count=20, distances_m=(distance_m,), offset=0.0)

    views = ring_views(replace(scene, views=(), approaches=(approach,)))

    at = distance_m * rays(np.array([159.5, 119.5]), scene.rig.camera)
    radius_m = [np.linalg.norm(at - view.center_m) for view in views]
    off_plane_m = [abs((at - view.center_m) @ view.normal) for view in views]
    assert np.allclose(radius_m, 0.582, atol=1e-9)
    assert max(off_plane_m) < 1e-9
