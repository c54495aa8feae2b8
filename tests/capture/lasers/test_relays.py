"""Settings of relay boards from their URIs."""

import pytest

from ringpose.capture.lasers.driver import LaserContext
from ringpose.capture.uri import LASERS, device_uri, driver

RIG = ("left", "middle", "right")


def settings_of(text, names=None):
    uri = device_uri(text, "--lasers", LASERS)
    return driver(LASERS, uri.scheme)(uri, LaserContext(names=names)).settings


@pytest.mark.parametrize(
    ("channels", "relays"),
    [("1,2,3", (0, 1, 2)), ("4,1,8", (3, 0, 7)), ("right:4,left:1,middle:2", (0, 1, 3))],
)
def test_channels_are_in_the_order_of_the_rig_or_have_its_names(channels, relays):
    assert settings_of(f"lcus:/dev/x?ch={channels}", RIG).relays == relays


@pytest.mark.parametrize(("scheme", "channels"), [("lcus", "2"), ("numato", "1"), ("modbus", "1")])
def test_relay_numbers_start_at_the_first_of_the_board(scheme, channels):
    assert settings_of(f"{scheme}:/dev/x?ch={channels}").relays == (1,)


def test_a_modbus_clone_has_its_own_base_and_value():
    settings = settings_of("modbus:/dev/x?ch=1,2&base=1&on=0100&unit=255&pulse=0.7&baud=19200")

    assert settings.relays == (0, 1)
    assert settings.codec_parameters == {"unit": 255, "first": 1, "on_value": 0x0100}
    assert (settings.pulse_s, settings.baud, settings.on_limit_s) == (0.7, 19200, 0.7)


def test_templates_of_text_may_have_spaces():
    settings = settings_of("ascii:/dev/x?ch=1&on=R{n}%20ON&off=R{n}+OFF&read=R?&ok=OK")

    assert settings.codec_parameters == {"on": "R{n} ON", "off": "R{n} OFF", "read": "R?", "acknowledged_by": "OK"}
    assert settings.opening_s == 2.0
