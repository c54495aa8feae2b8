"""Devices by name."""

import pytest

from ringpose.capture.uri import CAMERAS, LASERS, scheme_and_rest
from ringpose.errors import UsageError


@pytest.mark.parametrize(
    ("uri", "parts"),
    [
        ("files:shots", ("files", "shots")),
        ("files:a:b/*.png", ("files", "a:b/*.png")),
        ("sim:scene.yaml", ("sim", "scene.yaml")),
    ],
)
def test_a_uri_is_parted_at_its_first_colon(uri, parts):
    assert scheme_and_rest(uri, "--camera", CAMERAS) == parts


@pytest.mark.parametrize(
    ("uri", "remedy"),
    [
        ("file:shots", "did you mean files:shots"),
        ("shots", "it begins with one of files:, sim:"),
        ("", "one of files:"),
    ],
)
def test_an_unknown_device_is_wrong_usage(uri, remedy):
    with pytest.raises(UsageError, match=remedy):
        scheme_and_rest(uri, "--camera", CAMERAS)


def test_a_camera_is_no_laser():
    with pytest.raises(UsageError, match='--lasers: "files:shots" names no device'):
        scheme_and_rest("files:shots", "--lasers", LASERS)
