"""`ringpose capture` from a simulated scene."""

from pathlib import Path

import numpy as np
import pytest
from small_rig import write_scene

from ringpose.files.images.sessions import read_session
from ringpose.files.images.shots import read_shot

FIRST = Path("s/z0500_p00_dim.npz")


@pytest.fixture
def scene(tmp_path, monkeypatch):
    """Writes a small scene with these lines, and enters its folder."""
    monkeypatch.chdir(tmp_path)
    return lambda *lines: write_scene(tmp_path, "stripe_dn: 200", *lines)


@pytest.fixture
def capture(run, scene):
    """Runs `ringpose capture` of the scene into the session `s`."""
    file = scene("sequence: off,all")
    return lambda *words: run("capture", "--camera", f"sim:{file}", "--output", "s", *words)


def test_a_scene_is_captured_under_the_names_of_its_views(capture):
    status, out, _ = capture("--count", 2)

    assert (status, out) == (0, [str(FIRST), "s/z0500_p01_dim.npz"])
    shot = read_shot(FIRST)
    assert shot.lasers.tolist() == [0, 7]
    assert shot.read_lasers is not None
    assert shot.read_lasers.tolist() == [0, 7]
    assert shot.images[0].max() < 50 < shot.images[1].max()


def test_a_simulated_shot_lights_one_laser_after_the_other(capture):
    capture("--sequence", "1,2,3", "--count", 1)

    shot = read_shot(FIRST)
    rows = [int(np.argmax((image > 60).sum(axis=1))) for image in shot.images]
    assert shot.lasers.tolist() == [1, 2, 4]
    assert len(set(rows)) == 3


def test_the_exposure_that_is_asked_for_is_taken(capture):
    capture("--exposure", 0.002, "--count", 1)

    assert read_shot(FIRST).exposure_s.tolist() == [0.002, 0.002]


def test_the_session_of_a_scene_names_camera_lasers_and_sequence(capture, tmp_path):
    capture("--count", 1)

    (session,) = read_session(Path("s")).captures
    assert (session.camera_name, session.laser_count, session.lasers) == ("small", 3, "sim:")
    assert session.sequence == "off,all"
    assert list(session.provenance["inputs"]) == [str(tmp_path / "scene.yaml")]


@pytest.mark.parametrize(
    ("words", "complaint"),
    [
        (["--sequence", "off,4"], 'step "4" names laser 4 of a rig with 3 lasers'),
        (["--lasers", "none:", "--sequence", "off,all"], 'nothing switches the lasers for step "off"'),
    ],
)
def test_lasers_that_cannot_do_a_step_are_wrong_usage(capture, words, complaint):
    status, _, messages = capture(*words)

    assert status == 2
    assert complaint in messages[0]
    assert not Path("s").exists()


def test_lasers_that_nothing_switches_are_on(capture):
    assert capture("--lasers", "none:", "--count", 1).status == 0

    shot = read_shot(FIRST)
    assert shot.lasers.tolist() == [7]
    assert shot.images.max() > 100


def blinking(times: str) -> tuple[str, ...]:
    """Lines of a scene that is lit by a beacon."""
    beacon = f"beacon: {{ambient_w_m2: 8.0, {times}}}"
    return "sequence: off,1,2,3,off", "sensor: {pixel_m: 18.0e-6}", f"lights: {{dim: {{{beacon}}}}}"


def test_shots_that_a_beacon_spoils_are_taken_again_and_counted(capture, scene):
    """The beacon changes 5 ms after the beginning of each shot, of which one lasts for 12 ms."""
    scene(*blinking("on_s: 0.05, off_s: 0.05, phase_s: 1767225600.005"))

    status, out, (first, message) = capture("--exposure", 0.0005)

    shots = [read_shot(Path(name)) for name in out]
    assert status == 0
    assert [shot.name for shot in shots] == ["z0500_p00_dim", "z0500_p01_dim", "z0500_p02_dim"]
    assert "z0500_p00_dim: lost and taken again: ambient light" in first
    assert "ambient light: 3 shots were lost" in message
    assert "settle" not in first + message
    for shot in shots:
        assert len(shot.meta["attempts_lost"]["ambient_changed"]) == 1
        assert abs(float(shot.images[0].mean()) - float(shot.images[-1].mean())) < 0.5


def test_light_that_changes_in_every_shot_ends_the_capture_and_is_reported_from_the_first_on(capture, scene):
    scene(*blinking("on_s: 0.006, off_s: 0.006"))

    status, out, (first, message) = capture("--exposure", 0.0005)

    assert (status, out) == (69, [])
    assert "z0500_p00_dim: lost and taken again: ambient light" in first
    assert "ambient light: changed within each of 10 shots" in message
    assert "settle" not in first + message


@pytest.mark.parametrize("words", [[], ["--track"]])
def test_a_live_shot_in_which_light_changes_is_a_line_without_a_pose(scene, run, words):
    scene(*blinking("on_s: 0.006, off_s: 0.006"))

    found = run("pose", "--camera", "sim:scene.yaml", "--rig", "rig.yaml", "--exposure", 0.0005, *words)

    assert found.status == 3
    assert found.records[-1]["shot"] == "z0500_p02_dim"
    for record in found.records:
        assert (record["status"], record["pose"]) == ("none", None)
        assert "ambient light" in record["reason"]
        assert words or record["flags"] == ["ambient_changed"]
    (message,) = found.messages
    assert "z0500_p00_dim: lost: ambient light" in message
