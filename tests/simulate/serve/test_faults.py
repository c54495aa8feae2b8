"""Parsing of the option --fault."""

import pytest

from ringpose.errors import UsageError
from ringpose.simulate.serve.faults import parsed_faults


def test_faults_are_passed_to_their_devices():
    faults = parsed_faults(["loss=0.002", "dead-camera=20", "stuck:2", "late:3=0.05", "operate=0.008", "unplug=7"], 3)

    assert (faults.camera.loss, faults.camera.dies_after, faults.unplug_after) == (0.002, 20, 7)
    assert faults.contacts.stuck == {1}
    assert faults.contacts.late_s == {2: 0.05}
    assert faults.contacts.operate_s == 0.008


@pytest.mark.parametrize(
    ("text", "remedy"),
    [
        ("los=1", "is not a fault; give one of loss"),
        ("loss", "give loss=0.002"),
        ("loss=1", "give loss=0.002"),
        ("loss=nan", "give loss=0.002"),
        ("stuck", "give stuck:2"),
        ("stuck:4", "lasers are numbered from 1 to 3"),
        ("late:1=x", "give late:2=0.05"),
        ("no-resend=1", "give no-resend"),
        ("dead-camera=inf", "give dead-camera=20"),
        ("unplug=2.5", "give unplug=20"),
        ("operate=inf", "give operate=0.008"),
    ],
)
def test_an_invalid_fault_is_a_usage_error(text, remedy):
    with pytest.raises(UsageError, match=remedy):
        parsed_faults([text], 3)
