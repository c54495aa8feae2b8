"""`simulate serve --images` with `capture` and `pose` as its clients, as processes."""

import json
import signal
import stat
from pathlib import Path

import pytest
from forked import Forked
from served_scene import small_scene
from small_rig import SERVED_RIG, write_scene

from ringpose.cli.main import main
from ringpose.files.images.shots import read_shot

EXAMPLES = Path(__file__).parents[2] / "examples"


@pytest.fixture
def serve_images(serving):
    """Start a server of images and return its process and URIs."""
    return lambda *options, scene="scene.yaml", port=0: serving("--images", f"tcp://127.0.0.1:{port}", scene, *options)


def poses(capsys):
    return [json.loads(line) for line in capsys.readouterr().out.splitlines()]


def test_shots_are_captured_under_the_names_of_the_truth(serve_images):
    process, uris = serve_images("--rate", "50", "--truth", "truth.jsonl")

    assert main(["capture", "--camera", uris["camera"], "--count", "2", "-o", "s", "--quiet"]) == 0

    names = {path.stem for path in Path("s").glob("*.npz")}
    truths = {json.loads(line)["shot"] for line in Path("truth.jsonl").read_text().splitlines()}
    assert len(names) == 2
    assert names <= truths
    assert read_shot(next(Path("s").glob("*.npz")), None, None).lasers.tolist() == [0, 7]
    process.send_signal(signal.SIGTERM)
    assert process.wait(300) == 143


def test_in_lockstep_each_shot_gives_a_line_that_names_its_truth(serve_images, capsys):
    _, uris = serve_images("--clock", "lockstep", "--rate", "50", "--truth", "truth.jsonl")
    words = ["pose", "--rig", "rig.yaml", "--camera", uris["camera"], "--count", "4", "--brief", "--method", "paper"]

    assert main(words) in (0, 3)

    lines = poses(capsys)
    truths = [json.loads(line)["shot"] for line in Path("truth.jsonl").read_text().splitlines()]
    assert [line["shot"] for line in lines] == truths[:4]
    assert [line["shots_dropped"] for line in lines] == [0, 0, 0, 0]


def test_shots_that_are_lost_to_changing_light_have_the_servers_names_and_stamps(serve_images, capsys):
    beacon = "lights: {dim: {ambient_w_m2: 0.5, beacon: {ambient_w_m2: 8.0, on_s: 0.45, off_s: 0.45}}}"
    lines = "exposure_s: 0.005", "start_s: 100.0", "sequence: off,1,2,3,off", "sensor: {pixel_m: 18.0e-6}", beacon
    write_scene(Path(), *lines, rig=SERVED_RIG)
    _, uris = serve_images("--clock", "lockstep", "--rate", "20")

    assert main(["pose", "--rig", "rig.yaml", "--camera", uris["camera"], "--count", "8", "--brief"]) == 3

    lines, messages = capsys.readouterr()
    records = [json.loads(line) for line in lines.splitlines()]
    lost = [record["shot"] for record in records if "ambient_changed" in record["flags"]]
    assert len(lost) < len(records)
    assert messages.startswith(f"ringpose pose: {lost[0]}: lost")
    for record in records:
        begin_s = 100.0 + 5 * 0.05 * (int(record["shot"][-6:]) - 1)
        assert record["stamp_s"] == pytest.approx(begin_s + 0.05 + 0.0025)  # the second frame is the first one lit


def test_a_client_with_the_secret_file_is_admitted(serve_images, capsys):
    small_scene(Path())
    Path("secret").write_text("0123456789abcdef0123456789abcdef\n")
    Path("secret").chmod(0o600)
    _, uris = serve_images("--secret-file", "secret", "--rate", "50")
    words = ["capture", "--count", "1", "-o", "s", "--quiet"]

    assert main([*words, "--camera", f"{uris['camera']}?secret-file=secret"]) == 0
    assert main([*words, "--camera", uris["camera"], "--force"]) == 69
    assert "secret" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("words", "status", "key_word"),
    [
        (["--images", "tcp://0.0.0.0:0", "scene.yaml"], 2, "--secret-file"),
        (["--images", "127.0.0.1:5000", "scene.yaml"], 2, "tcp://"),
        (["--images", "tcp://127.0.0.1", "scene.yaml"], 2, "tcp://"),
        (["--images", "tcp://127.0.0.1:0/x", "scene.yaml"], 2, "tcp://"),
        (["--images", "tcp://127.0.0.1:0"], 2, "SCENE"),
        (["--images", "tcp://127.0.0.1:0", "scene.yaml", "--scene", "scene.yaml"], 2, "SCENE"),
        (["--images", "tcp://127.0.0.1:0", "scene.yaml", "--relay", "lcus"], 2, "--relay"),
        (["--images", "tcp://127.0.0.1:0", "scene.yaml", "--move", "never"], 2, "--move"),
        (["scene.yaml", "--clock", "lockstep"], 2, "--images"),
        (["scene.yaml", "--rate", "5"], 2, "--images"),
        (["--images", "tcp://127.0.0.1:0", "scene.yaml", "--secret-file", "missing"], 66, "missing"),
        (["--images", "tcp://127.0.0.1:0", "scene.yaml", "--secret-file", "short"], 65, "short"),
        (["--images", "tcp://127.0.0.1:0", "scene.yaml", "--secret-file", "open"], 65, "chmod"),
        (["--images", "tcp://127.0.0.1:0", "scene.yaml", "--rate", "1000"], 2, "--rate"),
    ],
)
def test_what_cannot_be_served_is_reported_in_one_line(tmp_path, monkeypatch, capsys, words, status, key_word):
    monkeypatch.chdir(tmp_path)
    small_scene(tmp_path)
    for name, text, mode in (("short", "0123", stat.S_IRUSR), ("open", "0123456789abcdef", 0o644)):
        Path(name).write_text(text)
        Path(name).chmod(mode)

    assert main(["simulate", "serve", *words]) == status

    error = capsys.readouterr().err
    assert error.count("\n") == 1
    assert key_word in error


def test_lasers_cannot_be_switched_by_another_device(capsys):
    assert main(["pose", "--rig", "r", "--camera", "tcp://127.0.0.1:1", "--lasers", "none:"]) in (2, 66)


@pytest.mark.slow
def test_clients_resume_after_the_server_is_killed_and_restarted(serve_images, forker):
    server, uris = serve_images("--rate", "20", "--truth", "a.jsonl")
    port = int(uris["camera"].rpartition(":")[2])
    words = ["capture", "--camera", uris["camera"], "--count", "40", "-o"]
    clients = [Forked(forker, [*words, name]) for name in "xy"]
    for client in clients:
        for _ in range(5):
            assert client.stdout.readline()
    server.kill()
    server.wait(300)
    serve_images("--rate", "20", "--truth", "b.jsonl", port=port)

    for client in clients:
        with client:
            assert client.wait(600) == 0
    truths = {
        json.loads(line)["shot"] for name in ("a.jsonl", "b.jsonl") for line in Path(name).read_text().splitlines()
    }
    for name in "xy":
        shots = {path.stem for path in Path(name).glob("*.npz")}
        assert len(shots) == 40
        assert shots <= truths


@pytest.mark.slow
def test_poses_of_the_shipped_scene_in_lockstep_are_right(serve_images, capsys):
    for name in ("scene.yaml", "scene-rig.yaml"):
        Path(name).write_text((EXAMPLES / name).read_text())
    _, uris = serve_images("--clock", "lockstep", "--rate", "50", "--truth", "truth.jsonl")
    words = ["pose", "--rig", "scene-rig.yaml", "--camera", uris["camera"], "--count", "7"]
    assert main(words) == 0
    Path("poses.jsonl").write_text(capsys.readouterr().out)

    assert main(["bench", "poses.jsonl", "--truth", "truth.jsonl", "--rig", "scene-rig.yaml", "--json", "-"]) == 0

    every = json.loads(capsys.readouterr().out)["groups"][-1]
    assert every["shots"] == 7
    assert every["wrong"]["none_wrong"]
