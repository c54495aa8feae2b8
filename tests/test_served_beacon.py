"""Captures and poses with a virtual camera while a beacon goes on and off and the target does not move."""

import itertools
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
from ringpose.simulate.serve.virtual_device import Setup, virtual_device
from ringpose.types.options import AdvancePolicy, Relay
from ringpose.types.scene import Beacon, Light

pytestmark = [pytest.mark.slow, pytest.mark.usefixtures("_aravis")]

SHOTS = ["--sequence", "off,1,2,3,off", "--exposure", "0.0008", "--settle", "0.03", "--count", "5"]

FRAMES = 13
"""Exposures between two changes of the beacon: more than two shots, so that some succeed."""


class FrameBeacon(Beacon):
    """A beacon that changes after every `FRAMES` exposures, so that the course does not depend on the machine's speed.

    The times of real beacons are those of tests/capture/test_changing_light.py and tests/simulate/test_pipeline.py.
    """

    exposure = itertools.count()

    def share_on(self, begin_s, duration_s):
        return float(next(self.exposure) // FRAMES % 2)


@pytest.fixture
def served_beside_beacon(tmp_path, monkeypatch, loopback_address):
    """Serves a virtual camera with LCUS relays and a beacon of 8 W/m2 that is off for the first exposures given."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    scene = small_scene(tmp_path)

    def served(first, contacts=None):
        monkeypatch.setattr(FrameBeacon, "exposure", itertools.count(FRAMES - first))
        beacon = FrameBeacon(ambient_w_m2=8.0, on_s=1.0, off_s=1.0)
        lit = replace(scene, lights={"dim": Light(name="dim", ambient_w_m2=0.5, beacon=beacon)})
        faults = InjectedFaults(contacts=contacts or RelayFaults())
        return virtual_device(
            lit, Setup(address=loopback_address, relay=Relay.LCUS, move=AdvancePolicy.NEVER, faults=faults)
        )

    return served


def devices(device):
    return ["--camera", device.uris["camera"], "--lasers", device.uris["lasers"]]


@pytest.mark.parametrize("first", [3, 9])
def test_a_capture_beside_a_beacon_completes_with_constant_light_in_each_shot(served_beside_beacon, capfd, first):
    with served_beside_beacon(first) as served:
        status = main(["capture", *devices(served), *SHOTS, "--output", "s"])

    names, messages = capfd.readouterr()
    assert (status, len(names.splitlines())) == (0, 5)
    assert "settle" not in messages
    shots = [read_shot(Path(name)) for name in names.splitlines()]
    for shot in shots:
        assert shot.seen_lasers.tolist() == [0, 1, 2, 4, 0]
        assert abs(float(np.median(shot.images[0])) - float(np.median(shot.images[-1]))) < 3
    assert any("attempts_lost" in shot.meta for shot in shots)
    assert len({np.median(shot.images[0]) > 50 for shot in shots}) == 2  # in either light


def test_poses_continue_beside_a_beacon_and_lost_shots_are_lines_without_a_pose(served_beside_beacon, capfd):
    with served_beside_beacon(8) as served:
        status = main(["pose", *devices(served), *SHOTS, "--rig", "rig.yaml"])

    lines, messages = capfd.readouterr()
    records = [json.loads(line) for line in lines.splitlines()]
    assert status in (0, 3)  # the small scene's shots need not all have a pose
    lost = [record for record in records if "ambient_changed" in record["flags"]]
    assert 1 <= len(lost) < len(records)
    assert all(record["pose"] is None for record in lost)
    assert "settle" not in messages


@pytest.mark.parametrize("fault", ["stuck", "welded"])
def test_a_laser_that_stays_on_beside_a_beacon_is_a_safety_fault(served_beside_beacon, capfd, fault):
    contacts = RelayFaults(**{fault: frozenset({1})})
    with served_beside_beacon(2, contacts) as served:
        status = main(["capture", *devices(served), *SHOTS, "--output", "s"])

    assert status == 70
    assert "laser 2 was" in capfd.readouterr().err
