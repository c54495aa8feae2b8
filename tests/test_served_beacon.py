"""Captures and poses with a virtual camera while a beacon goes on and off and the target does not move."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from served_scene import small_scene

from ringpose.cli.main import main
from ringpose.files.images.shots import read_shot
from ringpose.simulate.serve.faults import InjectedFaults
from ringpose.simulate.serve.relays import RelayFaults
from ringpose.simulate.serve.virtual_device import Setup, VirtualDevice
from ringpose.types.options import AdvancePolicy, Relay
from ringpose.types.scene import Beacon, Light

pytestmark = [pytest.mark.slow, pytest.mark.usefixtures("_aravis")]

SHOTS = ["--sequence", "off,1,2,3,off", "--exposure", "0.0008"]


@pytest.fixture
def beacon_before(tmp_path, monkeypatch, loopback_address):
    """Serves a virtual camera with LCUS relays and a beacon of 8 W/m2."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    scene = small_scene(tmp_path)

    def served(half_period_s, phase_s, contacts=None):
        beacon = Beacon(ambient_w_m2=8.0, on_s=half_period_s, off_s=half_period_s, phase_s=phase_s)
        lit = replace(scene, lights={"dim": Light(name="dim", ambient_w_m2=0.5, beacon=beacon)})
        faults = InjectedFaults(contacts=contacts or RelayFaults())
        return VirtualDevice(
            lit, Setup(address=loopback_address, relay=Relay.LCUS, move=AdvancePolicy.NEVER, faults=faults)
        )

    return served


def devices(device):
    return ["--camera", device.uris["camera"], "--lasers", device.uris["lasers"]]


@pytest.mark.parametrize("half_period_s", [0.45, 1.0])
@pytest.mark.parametrize("eighth", range(8))
def test_a_capture_beside_a_beacon_completes_with_constant_light_in_each_shot(
    beacon_before, capfd, half_period_s, eighth
):
    with beacon_before(half_period_s, eighth / 4 * half_period_s) as served:
        status = main(["capture", *devices(served), *SHOTS, "--settle", "0.03", "--count", "5", "--output", "s"])

    names, messages = capfd.readouterr()
    assert (status, len(names.splitlines())) == (0, 5)
    assert "settle" not in messages
    for name in names.splitlines():
        shot = read_shot(Path(name))
        assert shot.seen_lasers.tolist() == [0, 1, 2, 4, 0]
        assert abs(float(np.median(shot.images[0])) - float(np.median(shot.images[-1]))) < 3


@pytest.mark.parametrize("half_period_s", [0.45, 1.0])
def test_poses_continue_beside_a_beacon_and_lost_shots_are_counted(beacon_before, capfd, half_period_s):
    with beacon_before(half_period_s, 0.0) as served:
        words = ["--rig", "rig.yaml", "--settle", "0.03", "--duration", "8"]
        status = main(["pose", *devices(served), *SHOTS, *words])

    lines, messages = capfd.readouterr()
    records = [json.loads(line) for line in lines.splitlines()]
    assert status in (0, 3)  # the small scene's shots need not all have a pose
    assert len(records) >= 5
    assert sum(record["shots_dropped"] for record in records) >= 1
    assert "settle" not in messages


@pytest.mark.parametrize("fault", ["stuck", "welded"])
@pytest.mark.parametrize("half_period_s", [0.45, 1.0])
def test_a_laser_that_stays_on_beside_a_beacon_is_a_safety_fault(beacon_before, capfd, fault, half_period_s):
    contacts = RelayFaults(**{fault: frozenset({1})})
    with beacon_before(half_period_s, 0.1, contacts) as served:
        status = main(["capture", *devices(served), *SHOTS, "--settle", "0.03", "--count", "5", "--output", "s"])

    assert status == 70
    assert "laser 2 was" in capfd.readouterr().err
