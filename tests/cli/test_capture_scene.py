"""`ringpose capture` from a simulated scene."""

from pathlib import Path

import numpy as np
import pytest
from small_rig import SMALL_RIG

from ringpose.cli.main import main
from ringpose.files.images.sessions import read_session
from ringpose.files.images.shots import read_shot

SMALL_SCENE = """\
ringpose: scene/1
rig: rig.yaml
ring: {radius_inner_m: 0.567, radius_outer_m: 0.597, height_m: 0.06}
body: {size_m: [1.6, 1.6, 1.0]}
stripe_dn: 200
sequence: off,all
trajectory:
- generate: {count: 3, distances_m: [0.5], tilt_rad: 0.05}
"""


@pytest.fixture
def scene(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "rig.yaml").write_text(SMALL_RIG)
    (tmp_path / "scene.yaml").write_text(SMALL_SCENE)
    return tmp_path / "scene.yaml"


def test_a_scene_is_captured_under_the_names_of_its_views(scene, capsys):
    status = main(["capture", "--camera", f"sim:{scene}", "--count", "2", "--output", "s"])

    names = [Path(line).stem for line in capsys.readouterr().out.splitlines()]
    assert status == 0
    assert names == ["z0500_p00_dim", "z0500_p01_dim"]
    shot = read_shot(Path("s") / f"{names[0]}.npz")
    assert shot.lasers.tolist() == [0, 7]
    assert shot.read_lasers is not None
    assert shot.read_lasers.tolist() == [0, 7]
    assert shot.images[0].max() < 50 < shot.images[1].max()


def test_a_simulated_shot_lights_one_laser_after_the_other(scene):
    main(["capture", "--camera", f"sim:{scene}", "--sequence", "1,2,3", "--count", "1", "--output", "s"])

    shot = read_shot(Path("s/z0500_p00_dim.npz"))
    rows = [int(np.argmax((image > 60).sum(axis=1))) for image in shot.images]
    assert shot.lasers.tolist() == [1, 2, 4]
    assert len(set(rows)) == 3


def test_the_exposure_that_is_asked_for_is_taken(scene):
    main(["capture", "--camera", f"sim:{scene}", "--exposure", "0.002", "--count", "1", "--output", "s"])

    assert read_shot(Path("s/z0500_p00_dim.npz")).exposure_s.tolist() == [0.002, 0.002]


def test_the_session_of_a_scene_names_camera_lasers_and_sequence(scene):
    main(["capture", "--camera", f"sim:{scene}", "--count", "1", "--output", "s"])

    (capture,) = read_session(Path("s")).captures
    assert (capture.camera_name, capture.laser_count, capture.lasers) == ("small", 3, "sim:")
    assert capture.sequence == "off,all"
    assert list(capture.provenance["inputs"]) == [str(scene)]


@pytest.mark.parametrize(
    ("words", "complaint"),
    [
        (["--sequence", "off,4"], 'step "4" names laser 4 of a rig with 3 lasers'),
        (["--lasers", "none:", "--sequence", "off,all"], 'nothing switches the lasers for step "off"'),
    ],
)
def test_lasers_that_cannot_do_a_step_are_wrong_usage(scene, capsys, words, complaint):
    status = main(["capture", "--camera", f"sim:{scene}", *words, "--output", "s"])

    assert status == 2
    assert complaint in capsys.readouterr().err
    assert not Path("s").exists()


def test_lasers_that_nothing_switches_are_on(scene):
    status = main(["capture", "--camera", f"sim:{scene}", "--lasers", "none:", "--count", "1", "--output", "s"])

    shot = read_shot(Path("s/z0500_p00_dim.npz"))
    assert status == 0
    assert shot.lasers.tolist() == [7]
    assert shot.images.max() > 100


BLINKING_SCENE = SMALL_SCENE.replace("off,all", "off,1,2,3,off").replace(
    "trajectory", "sensor: {pixel_m: 18.0e-6}\nlights: {dim: {beacon: {ambient_w_m2: 8.0, ON_AND_OFF}}}\ntrajectory"
)


def test_shots_that_a_beacon_spoils_are_taken_again_and_counted(scene, capsys):
    """The beacon changes 5 ms after the beginning of each shot, of which one lasts for 12 ms."""
    scene.write_text(BLINKING_SCENE.replace("ON_AND_OFF", "on_s: 0.05, off_s: 0.05, phase_s: 1767225600.005"))

    status = main(["capture", "--camera", f"sim:{scene}", "--output", "s", "--exposure", "0.0005"])

    names, said = capsys.readouterr()
    shots = [read_shot(Path(name)) for name in names.splitlines()]
    assert status == 0
    assert [shot.name for shot in shots] == ["z0500_p00_dim", "z0500_p01_dim", "z0500_p02_dim"]
    assert "ambient light: 3 shots were lost" in said
    assert "settle" not in said
    for shot in shots:
        assert len(shot.meta["attempts_lost"]["ambient_changed"]) == 1
        assert abs(float(shot.images[0].mean()) - float(shot.images[-1].mean())) < 0.5


def test_light_that_changes_in_every_shot_ends_the_capture_with_one_line(scene, capsys):
    scene.write_text(BLINKING_SCENE.replace("ON_AND_OFF", "on_s: 0.006, off_s: 0.006"))

    status = main(["capture", "--camera", f"sim:{scene}", "--output", "s", "--exposure", "0.0005"])

    names, said = capsys.readouterr()
    assert (status, names) == (69, "")
    assert said.count("\n") == 1
    assert "ambient light: changed within each of 10 shots" in said
    assert "settle" not in said
