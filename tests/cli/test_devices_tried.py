"""`ringpose capture --test` and `--list`: devices tried and named before anything is measured with them."""

import json

import pytest

from ringpose.cli.main import main

pytestmark = pytest.mark.usefixtures("_aravis")


def findings(capsys) -> dict[str, dict[str, str]]:
    return {found["check"]: found for found in map(json.loads, capsys.readouterr().out.splitlines())}


@pytest.mark.slow
def test_a_dry_walk_finds_nothing_wrong_with_good_devices(serve, capsys):
    uris = serve("--relay", "lcus", "--fault", "operate=0.02", "--move", "never")

    devices = ["--camera", uris["camera"], "--lasers", uris["lasers"], "--exposure", "0.0005"]
    status = main(["capture", "--test", *devices])

    found = findings(capsys)
    assert status == 0
    assert found["verdict"]["verdict"] == "ok"
    assert {"laser 1", "laser 2", "laser 3", "exposure, laser 2", "frames"} <= set(found)
    settle_s = float(found["settle"]["found"].split("--settle ")[1].split()[0])
    assert settle_s > 0.02


@pytest.mark.slow
def test_a_dry_walk_finds_the_laser_that_is_dark(serve, capsys):
    uris = serve("--fault", "dark:2", "--move", "never")

    status = main(["capture", "--test", "--camera", uris["camera"], "--lasers", uris["lasers"]])

    found = findings(capsys)
    assert status == 3
    assert [name for name, finding in found.items() if finding["verdict"] == "fault"] == ["laser 2", "verdict"]
    assert "check that it shines" in found["laser 2"]["remedy"]


@pytest.mark.slow
def test_a_dry_walk_ends_at_a_laser_that_stays_on(serve, capsys):
    uris = serve("--relay", "modbus", "--fault", "stuck:2", "--move", "never")

    status = main(["capture", "--test", "--camera", uris["camera"], "--lasers", uris["lasers"]])

    assert status == 70
    assert "laser 2 was seen while all are off; cut the power" in capsys.readouterr().err


def test_recorded_shots_are_not_tested(capsys, example_folder):
    assert main(["capture", "--test", "--camera", f"files:{example_folder}/shots"]) == 2


def test_cameras_are_listed_by_their_uris(serve, capsys, loopback_address):
    serve()

    status = main(["capture", "--list"])

    listed = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    found = [record for record in listed if record.get("address") == loopback_address]
    assert status == 0
    assert [record["kind"] for record in found] == ["camera"]
    assert found[0]["uri"].startswith("aravis:ringpose-Stand-in-RP")
