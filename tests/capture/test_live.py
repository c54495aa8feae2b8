"""A live camera gives the lines of the stream of its shots."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from ringpose.capture.live import live_lines
from ringpose.capture.source import CaptureRequest, Source, TrackedSequence
from ringpose.errors import DataError
from ringpose.files.images.shots import checked_shot, read_shot
from ringpose.files.rigs import read_rig
from ringpose.measure.stream import Setup, Stream, track_options
from ringpose.types.assumptions import USUAL
from ringpose.types.session import Capture, parsed_sequence

REQUEST = CaptureRequest(camera="test:")


@pytest.fixture(scope="module")
def rig(carried_data):
    return read_rig(carried_data / "rig_b" / "rig.yaml")


@pytest.fixture(scope="module")
def shots(carried_data, rig):
    files = sorted((carried_data / "rig_b" / "shots").glob("B_z0500*dim.npz"))[:2]
    return [replace(read_shot(file, None, rig), name=f"{number}") for number, file in enumerate(files)]


def source_of(shots, requests):
    """A function that opens a source of these shots, whose time stands still between them."""

    def opened(request):
        requests.append(request)
        capture = Capture(camera=request.camera, lasers="none:")
        return Source(capture=capture, shots=lambda _on_read, _existing: iter(shots), waits_for_consumer=True)

    return opened


def test_a_live_camera_gives_the_lines_of_the_stream_of_its_shots(rig, shots):
    stream = Stream(Setup(rig=rig))
    expected = [stream.measure(shot).line for shot in shots]

    with live_lines(REQUEST, source_of(shots, []), partial(Stream, Setup(rig=rig)), checked_shot) as lines:
        measured = [each.line for each in lines]

    assert [line.shot for line in measured] == [shot.name for shot in shots]
    assert [line.shots_dropped for line in measured] == [0, 0]
    for line, other in zip(measured, expected, strict=True):
        assert (line.status, line.flags) == (other.status, other.flags)
        np.testing.assert_array_equal(line.pose.center_m, other.pose.center_m)


@pytest.mark.parametrize(
    ("steps", "track", "chooses"), [("", True, True), ("off,all", True, False), ("", False, False)]
)
def test_the_track_chooses_the_lasers_unless_the_request_does(rig, shots, steps, track, chooses):
    request, requests = replace(REQUEST, steps=parsed_sequence(steps) if steps else None), []
    open_stream = partial(Stream, Setup(rig=rig), track_options(USUAL) if track else None)

    with live_lines(request, source_of(shots[:1], requests), open_stream, checked_shot) as lines:
        list(lines)

    assert isinstance(requests[0].choose, TrackedSequence) == chooses
    assert requests[0].yields_lost


def test_a_shot_that_does_not_fit_the_rig_ends_the_lines(rig, shots):
    wrong = replace(shots[0], lasers=np.full_like(shots[0].lasers, 8))

    with (
        live_lines(REQUEST, source_of([wrong], []), partial(Stream, Setup(rig=rig)), checked_shot) as lines,
        pytest.raises(DataError, match="test:"),
    ):
        next(lines)
