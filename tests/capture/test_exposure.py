"""Automatic exposure: stripes of known brightness, seen by a fake camera that saturates."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from fake_camera import FakeCamera
from small_rig import SERVED_RIG, write_scene

from ringpose.capture.cameras.simulated import SimulatedLasers
from ringpose.capture.exposure import ExposureControl, wanted_exposures
from ringpose.capture.pipeline import Procedure, captured_shots
from ringpose.cli.main import main
from ringpose.files.images.shots import read_shot
from ringpose.files.rigs import read_rig
from ringpose.types.image import Frame, Shot
from ringpose.types.session import parsed_sequence

FULL_DN = 255
ROWS = (30.0, 60.0, 90.0)
STEPS = parsed_sequence("off,1,2,3,off")


class Scene(FakeCamera):
    """A camera before three horizontal stripes; grey values are rates times the exposure, with noise."""

    image_width, image_height = 200, 120

    def __init__(
        self, stripe_dn_s: tuple[float, ...], ambient_dn_s: float = 0.0, first_s: float = 0.01, sigma_px: float = 1.5
    ) -> None:
        y = np.arange(120.0)[:, None]
        self._stripes = [
            rate * np.exp(-0.5 * ((y - row) / sigma_px) ** 2) * np.ones(200)
            for rate, row in zip(stripe_dn_s, ROWS, strict=True)
        ]
        self._ambient_dn_s = ambient_dn_s
        self._armed_s = self._first_s = first_s
        self._rng = np.random.default_rng(5)
        self._stamp_s = 0.0

    def bounds(self, feature: str) -> tuple[float, float]:
        return 10.0, 50_000.0

    def arm(self, exposure_s: float | None) -> None:
        self._armed_s = self._first_s if exposure_s is None else exposure_s

    def trigger(self, lasers: int, exposure_s: float | None = None) -> Frame:
        exposure_s = self._armed_s if exposure_s is None else exposure_s
        lit = [stripe for laser, stripe in enumerate(self._stripes) if lasers >> laser & 1]
        grey = exposure_s * (self._ambient_dn_s + sum(lit)) + self._rng.normal(2.0, 0.7, (120, 200))
        self._stamp_s += exposure_s
        image = np.clip(np.rint(grey), 0, FULL_DN).astype(np.uint8)
        return Frame(image=image, lasers=lasers, stamp_s=self._stamp_s, exposure_s=exposure_s)


def first_shot(scene: Scene) -> Shot:
    lasers = SimulatedLasers(3)
    procedure = Procedure(steps=STEPS, is_exposure_auto=True)
    return next(captured_shots(scene, lasers, procedure, ["first"]))


@pytest.mark.parametrize("first_s", [0.00003, 0.002, 0.05])
@pytest.mark.parametrize("ambient_dn_s", [0.0, 30_000.0])
def test_the_first_shot_is_neither_dim_nor_saturated_wherever_the_exposure_begins(first_s, ambient_dn_s):
    shot = first_shot(Scene((60_000.0, 80_000.0, 50_000.0), ambient_dn_s, first_s))

    brightest_dn = np.percentile(shot.images[2][60], 90)
    assert 0.35 * FULL_DN < brightest_dn < FULL_DN


def test_a_thin_stripe_is_exposed_by_its_brightest_row():
    shot = first_shot(Scene((60_000.0, 80_000.0, 50_000.0), sigma_px=0.7))

    assert 0.35 * FULL_DN < np.percentile(shot.images[2][60], 90) < FULL_DN


@pytest.mark.parametrize("first_s", [0.001, 0.02])
def test_lasers_that_differ_in_brightness_have_each_their_exposure_and_the_background_all(first_s):
    shot = first_shot(Scene((80_000.0, 40_000.0, 3_000.0), first_s=first_s))

    background, *lasers, again = shot.meta["merged"]["exposures_s"]
    (short_s,), (same_s,), (long_s,) = lasers
    assert (background, again, same_s) == ([short_s, long_s], [short_s, long_s], short_s)
    assert 0.3 * FULL_DN < 80_000 * short_s < FULL_DN
    assert 0.3 * FULL_DN < 3_000 * long_s < FULL_DN
    assert len(shot.images) == len(STEPS)


@pytest.mark.parametrize(("ratio", "exposures"), [(2.0, 1), (4.0, 2)])
def test_exposures_of_lasers_differ_from_a_ratio_of_three_on_and_are_then_kept(ratio, exposures):
    scene, lasers = Scene((60_000.0, 60_000.0, 60_000.0 / ratio)), SimulatedLasers(3)
    procedure = Procedure(steps=parsed_sequence("off,1,2,3,all"), is_exposure_auto=True)

    _, shot = captured_shots(scene, lasers, procedure, ["first", "second"])

    used_s = {each for group in shot.meta["merged"]["exposures_s"] for each in group} if exposures > 1 else {0.0}
    assert len(used_s) == exposures
    assert exposures == 1 or len(shot.meta["merged"]["exposures_s"][-1]) == exposures
    assert ("merged" in shot.meta) == (exposures > 1)


def test_ambient_light_counts_as_part_of_a_stripe_s_brightness():
    scene = Scene((30_000.0,) * 3, ambient_dn_s=60_000.0)
    shot = next(captured_shots(scene, SimulatedLasers(3), Procedure(steps=STEPS, exposure_s=0.001), ["dim"]))

    wanted = wanted_exposures(shot, 3, None)

    assert [each.best_s for each in wanted.values()] == pytest.approx([0.75 * FULL_DN / 90_000] * 3, rel=0.1)


def test_an_empty_image_is_exposed_longer_and_a_white_one_shorter():
    shot = next(captured_shots(Scene((0.0,) * 3), SimulatedLasers(3), Procedure(steps=STEPS, exposure_s=0.01), ["-"]))
    white = replace(shot, images=np.full_like(shot.images, FULL_DN))

    assert wanted_exposures(shot, 3, None)[2].best_s == pytest.approx(0.04)
    assert wanted_exposures(white, 3, None)[2].best_s == pytest.approx(0.0025)


def test_a_ring_hidden_by_saturated_light_is_exposed_shorter_and_not_as_long_again(rig_of_scene):
    scene = Scene((40.0, 60.0, 50.0))
    shot = next(captured_shots(scene, SimulatedLasers(3), Procedure(steps=STEPS, exposure_s=0.01), ["-"]))
    images = shot.images.copy()
    images[:, :60] = FULL_DN
    control = ExposureControl(rig_of_scene, 3, 1e-5, 0.1)

    assert not control.accepts(replace(shot, images=images))
    assert control.exposures is not None
    assert control.exposures[2] == pytest.approx(0.0025)

    dim = replace(shot, exposure_s=np.full(len(STEPS), 0.0025))
    assert not control.accepts(dim)  # its stripes alone suggest four times the exposure
    assert 0.0025 < control.exposures[2] < 0.01


@pytest.fixture
def rig_of_scene(tmp_path):
    (tmp_path / "rig.yaml").write_text(SERVED_RIG)
    return read_rig(tmp_path / "rig.yaml")


def test_exposures_stay_within_the_limits():
    shot = next(captured_shots(Scene((0.0,) * 3), SimulatedLasers(3), Procedure(steps=STEPS, exposure_s=0.01), ["-"]))
    control = ExposureControl(None, 3, 1e-4, 0.01)

    assert control.accepts(shot)  # a longer one is not to be had
    assert control.exposures is not None
    assert control.exposures == {0: 0.01, 1: 0.01, 2: 0.01}


@pytest.mark.parametrize("words", [["--exposure", "bright"], ["--exposure", "0"], ["--exposure", "nan"]])
def test_an_exposure_is_seconds_or_auto(words, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)

    assert main(["capture", "--camera", "sim:scene.yaml", *words]) == 2
    assert "--exposure" in capsys.readouterr().err


@pytest.fixture
def scene_file(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    return write_scene(tmp_path, "exposure_s: 0.05", "sequence: off,all", count=1)


@pytest.mark.parametrize("rig", [[], ["--rig", "rig.yaml"]])
def test_a_scene_that_would_saturate_is_captured_with_a_shorter_exposure(scene_file, rig):
    status = main(["capture", "--camera", f"sim:{scene_file}", "--exposure", "auto", "--output", "s", *rig])

    shot = read_shot(next(Path("s").glob("*.npz")))
    assert status == 0
    assert shot.exposure_s.max() < 0.02
    assert (shot.images[1] == FULL_DN).mean() < 0.005


def test_an_automatic_exposure_excludes_exposures_of_single_steps(scene_file, capsys):
    words = ["--exposure", "auto", "--sequence", "off,all@1ms", "--output", "s"]

    assert main(["capture", "--camera", f"sim:{scene_file}", *words]) == 2
    assert "--exposure" in capsys.readouterr().err
