"""Parsing of device URIs."""

import pytest

from ringpose.capture.uri import CAMERAS, LASERS, device_uri, scheme_and_rest
from ringpose.errors import UsageError


@pytest.mark.parametrize(
    ("uri", "parts"),
    [
        ("files:shots", ("files", "shots")),
        ("files:a:b/*.png", ("files", "a:b/*.png")),
        ("sim:scene.yaml", ("sim", "scene.yaml")),
    ],
)
def test_a_uri_is_split_at_its_first_colon(uri, parts):
    assert scheme_and_rest(uri, "--camera", ("files", "sim")) == parts


@pytest.mark.parametrize(
    ("uri", "remedy"),
    [
        ("file:shots", "did you mean files:shots"),
        ("shots", "it begins with one of files:, sim:"),
        ("", "one of files:"),
    ],
)
def test_an_unknown_scheme_is_a_usage_error(uri, remedy):
    with pytest.raises(UsageError, match=remedy):
        scheme_and_rest(uri, "--camera", ("files", "sim"))


def test_the_scheme_of_a_camera_is_not_accepted_for_lasers():
    with pytest.raises(UsageError, match='--lasers: "files:shots" names no device'):
        device_uri("files:shots", "--lasers", LASERS)


def test_a_device_uri_has_an_address_and_parameters():
    uri = device_uri("files:///dev/serial/by-id/a?ch=1,2&note=a%20b", "--camera", CAMERAS)

    assert uri.address == "/dev/serial/by-id/a"
    assert uri.parameters == {"ch": "1,2", "note": "a b"}


@pytest.mark.parametrize(
    ("written", "problem"),
    [
        ("high", "must be a number"),
        ("nan", "must be a number"),
        ("inf", "must be a number"),
        ("-1", "it takes 0.5 to 9"),
        ("9.5", "it takes 0.5 to 9"),
    ],
)
def test_a_number_lies_within_its_bounds(written, problem):
    uri = device_uri(f"sim:scene.yaml?timeout={written}", "--camera", CAMERAS)

    with pytest.raises(UsageError, match=f'timeout is "{written}".*{problem}'):
        uri.number("timeout", 2.0, 0.5, 9.0)


@pytest.mark.parametrize(("written", "problem"), [("0.5", "must be a whole number"), ("-1", "it takes 0 to 9")])
def test_a_count_must_be_a_whole_number(written, problem):
    uri = device_uri(f"sim:scene.yaml?skip={written}", "--camera", CAMERAS)

    with pytest.raises(UsageError, match=f'skip is "{written}".*{problem}'):
        uri.whole("skip", 0, 9)
