"""A stream of shots gives the same lines wherever it is measured; it corrects and predicts from shot to shot."""

import csv
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from golden_lines import LEFT_OUT, differences
from moving_cameras import robot
from moving_rings import START_S

from ringpose.bench.study.shots import run_result
from ringpose.capture.latest_frame import EarlyStripes
from ringpose.capture.source import CaptureRequest, Source, capture_record
from ringpose.cli.main import main
from ringpose.console.engine import ConsolePicture, Engine
from ringpose.console.state import first_state
from ringpose.detect.difference_images import laser_images
from ringpose.errors import DataError
from ringpose.files import records
from ringpose.files.images.shots import read_shot, write_shot
from ringpose.files.inputs import SourceReader
from ringpose.files.records.poses import pose_record
from ringpose.files.records.tracks import track_record
from ringpose.files.records.truths import truth_record
from ringpose.files.rigs import read_rig, write_rig
from ringpose.files.scenes.scene import read_scene
from ringpose.geometry.camera_motion import CameraMotion
from ringpose.geometry.rotations import tilted
from ringpose.measure.stream import Setup, Stream, track_options
from ringpose.simulate.features import Deviations, drawn_features
from ringpose.simulate.placement import ring_views
from ringpose.types.assumptions import USUAL, AssumptionOptions
from ringpose.types.image import Shot
from ringpose.types.pose import KnownRadii, PoseFlag
from ringpose.types.scene import Approach
from ringpose.types.study import StudyMethod

EXAMPLE = Path(__file__).parents[2] / "examples" / "scene.yaml"
SHOTS = 4
STILL = AssumptionOptions(still=True)
NO_RADII = KnownRadii(radius_m=np.full(2, np.nan), sd_m=np.ones(2))


@pytest.fixture(scope="module")
def scene():
    return read_scene(EXAMPLE)


@pytest.fixture(scope="module")
def pictures(scene) -> list[ConsolePicture]:
    """What the console measures of a target that drifts."""
    state = replace(first_state(scene, ring_views(scene)[0]), drift_m_s=np.array([0.01, 0.0, -0.01]), width=640)
    engine = Engine(scene, lambda *_: None)
    states = [replace(state, masks=(0, 1, 2, 4), time_s=0.2 * number, number=number) for number in range(SHOTS)]
    return [engine.measured(each) for each in states]


@pytest.fixture(scope="module")
def folder(pictures, tmp_path_factory) -> Path:
    """A data set of the same shots."""
    folder = tmp_path_factory.mktemp("stream")
    (folder / "shots").mkdir()
    for picture in pictures:
        write_shot(folder / "shots" / f"{picture.shot.name}.npz", picture.shot)
    truths = [records.line_of(truth_record(picture.shot_truth)) for picture in pictures]
    (folder / "truth.jsonl").write_text("".join(truths))
    write_rig(folder / "rig.yaml", pictures[0].rig)
    return folder


@pytest.fixture(scope="module")
def shots(folder) -> list[Shot]:
    return [read_shot(path) for path in sorted((folder / "shots").iterdir())]


@pytest.fixture(scope="module")
def expected(folder, shots) -> dict[str, list]:
    """The records of the library, of a stream with and of one without a track."""
    rig = read_rig(folder / "rig.yaml")
    alone, tracking = Stream(Setup(rig=rig)), Stream(Setup(rig=rig), track_options(USUAL))
    found = [tracking.measure(shot) for shot in shots]
    return {
        "pose": [recorded(pose_record(alone.measure(shot).line)) for shot in shots],
        "pose --track": [recorded(track_record(measured.track)) for measured in found],
        "console": [recorded(pose_record(measured.line)) for measured in found],
    }


def recorded(record) -> dict:
    """A record as it is read, without times, and without the hash of the rig's file."""
    record = records.plain(record)
    return {key: value for key, value in record.items() if key not in (*LEFT_OUT, "rig")}


def assert_same(found, expected) -> None:
    assert len(found) == len(expected)
    for record, each in zip(found, expected, strict=True):
        assert differences(each, record) == []


@pytest.fixture
def command(folder, capsys):
    """The records that `ringpose pose` writes."""

    def records_of(*words) -> list[dict]:
        assert main(["pose", *map(str, words), "--rig", str(folder / "rig.yaml"), "--quiet"]) == 0
        return [recorded(json.loads(line)) for line in capsys.readouterr().out.splitlines()]

    return records_of


@pytest.mark.parametrize("options", [[], ["--track"]])
def test_the_command_writes_the_lines_of_the_library(command, folder, expected, options):
    assert_same(command(folder / "shots", *options), expected[" ".join(["pose", *options])])


@pytest.mark.slow
def test_several_processes_write_the_lines_of_the_library(command, folder, expected):
    assert_same(command(folder / "shots", "--jobs", 2), expected["pose"])


@pytest.mark.parametrize("options", [[], ["--track"]])
def test_a_live_camera_gives_the_lines_of_the_library(command, shots, expected, options, monkeypatch):
    def source_of(request: CaptureRequest, batch) -> Source:
        return Source(
            capture=capture_record(request), shots=lambda on_read, existing: iter(shots), waits_for_consumer=True
        )

    monkeypatch.setattr("ringpose.cli.acquisition.source_of", source_of)

    assert_same(command("--camera", "sim:x", *options), expected[" ".join(["pose", *options])])


def test_the_console_shows_the_lines_of_the_library(pictures, expected):
    assert_same([recorded(pose_record(picture.line)) for picture in pictures], expected["console"])
    assert_same([recorded(track_record(picture.track)) for picture in pictures], expected["pose --track"])


def test_a_study_scores_the_lines_of_the_library(folder, shots, expected):
    methods = [StudyMethod.ML, StudyMethod.TRACK]

    result = run_result(shots, read_rig(folder / "rig.yaml"), methods, NO_RADII, USUAL)

    assert_same([recorded(pose_record(result.lines[StudyMethod.ML]))], expected["pose"][-1:])
    track = recorded(pose_record(result.lines[StudyMethod.TRACK]))
    of_track = {key: expected["pose --track"][-1][key] for key in ("pose", "velocity", "flags", "status")}
    assert_same([{**track, **of_track}], [track])


def test_a_data_set_is_scored_by_the_lines_of_the_command(folder, tmp_path, capsys):
    assert main(["pose", str(folder / "shots"), "--rig", str(folder / "rig.yaml"), "--quiet"]) == 0
    (tmp_path / "poses.jsonl").write_text(capsys.readouterr().out)

    def scores(*words) -> list[dict]:
        assert main(["bench", *map(str, words), "--quiet", "--csv", "-"]) == 0
        rows = csv.DictReader(capsys.readouterr().out.splitlines())
        return [{key: value for key, value in row.items() if key not in LEFT_OUT} for row in rows]

    of_folder = scores(folder, "--method", "ml")

    assert of_folder == scores(tmp_path / "poses.jsonl", "--truth", folder / "truth.jsonl")
    assert len(of_folder) == SHOTS


def test_a_shot_that_the_track_cannot_use_has_a_line_and_the_reason_and_the_stream_goes_on(folder, shots):
    stream = Stream(Setup(rig=read_rig(folder / "rig.yaml")), track_options(USUAL))

    first, again, second = (stream.measure(shot) for shot in (shots[0], shots[0], shots[1]))

    assert first.problem is None
    assert isinstance(again.problem, DataError)
    assert (again.line.status, again.track) == (first.line.status, None)
    assert second.track.attempt.fusion_status == "fused"


def test_a_run_whose_last_shot_shows_nothing_has_the_prediction_of_its_track(folder, shots):
    dark = replace(shots[-1], images=np.zeros_like(shots[-1].images))
    methods = [StudyMethod.ML, StudyMethod.TRACK]

    result = run_result([*shots[:-1], dark], read_rig(folder / "rig.yaml"), methods, NO_RADII, USUAL)

    assert result.lines[StudyMethod.ML].pose is None
    predicted = result.lines[StudyMethod.TRACK]
    assert predicted.pose_stamp_s == dark.measured_at_s
    assert np.isfinite(predicted.pose.grasp_m).all()


@pytest.fixture(scope="module")
def turned_run(scene):
    """Detections of many poses by a rig of which one light plane has turned."""
    approach = Approach(count=12, distances_m=(0.4,), name="s")
    scene = replace(scene, approaches=(approach,), views=(), camera_boards=None, plane_boards=None)
    lasers = scene.rig.lasers
    normal = lasers.normal.copy()
    normal[0] = tilted(normal[0], np.radians([0.0, 0.3]))
    turned = replace(scene, rig=replace(scene.rig, lasers=replace(lasers, normal=normal)))
    return [drawn.detection for drawn in drawn_features(turned, Deviations())], scene.rig


@pytest.mark.slow
def test_a_run_with_a_turned_plane_is_measured_with_the_corrected_rig(turned_run):
    run, rig = turned_run

    line = run_result(run, rig, [StudyMethod.ML], NO_RADII, STILL).lines[StudyMethod.ML]

    assert PoseFlag.RIG_DRIFT in line.flags
    assert list(line.priors.moved_planes) == [rig.lasers.names[0]]


def test_a_stream_warns_once_of_a_plane_that_has_moved_and_measures_with_its_correction(turned_run):
    run, rig = turned_run
    stream = Stream(Setup(rig=rig, options=STILL))

    warned = [warning for detection in run for warning in stream.measure(detection).warnings]

    assert len(warned) == 1
    assert rig.lasers.names[0] in warned[0]
    assert "calibrate-planes" in warned[0]
    assert stream.rig is not rig


@pytest.mark.slow
def test_shots_after_a_correction_are_measured_again_with_it(turned_run):
    """By several processes, which measure them with the rig as it was given."""
    run, rig = turned_run
    stream, again = Stream(Setup(rig=rig, options=STILL)), Stream(Setup(rig=rig, options=STILL))

    found = list(again.outcomes(run, reading, 2))

    for measured, detection in zip(found, run, strict=True):
        assert differences(*(recorded(pose_record(each.line)) for each in (stream.measure(detection), measured))) == []


def test_a_source_that_cannot_be_read_has_its_error_as_outcome_and_the_others_their_lines(turned_run):
    run, rig = turned_run

    def read(number):
        if number == 1:
            raise DataError("a.npz", "is broken")
        return run[number]

    first, broken, last = Stream(Setup(rig=rig, options=STILL)).outcomes(range(3), read)

    assert [first.line.shot, str(broken), last.line.shot] == [run[0].shot, "a.npz: is broken", run[2].shot]


def reading(item):
    """Each item is its own source; worker processes import this function."""
    return item


def test_an_input_is_read_by_its_contents(folder, shots):
    read = SourceReader(read_rig(folder / "rig.yaml"))

    assert read(sorted((folder / "shots").iterdir())[0]).name == shots[0].name


def test_robot_poses_that_arrive_meanwhile_are_asked_for_up_to_the_last_frame_of_each_shot(folder, shots):
    shot = replace(shots[0], stamp_s=shots[0].stamp_s - shots[0].stamp_s[0] + START_S + 0.5)
    asked = []

    def motion_until(stamp_s: float) -> CameraMotion:
        asked.append(stamp_s)
        return robot(2.0)

    stream = Stream(Setup(rig=read_rig(folder / "rig.yaml")), track_options(USUAL), motion_until=motion_until)
    measured = stream.measure(shot)

    assert asked == [shot.mid_exposure_s(-1)]
    assert measured.line.measurement.camera_motion == "robot_poses"
    assert (measured.track.frame, measured.track.camera) == ("base", "robot_poses")


def test_stripes_that_were_found_early_are_not_searched_again(folder, shots):
    searched = EarlyStripes()
    for frame in shots[0].frames:
        searched.add(frame, shots[0].saturation_dn)
    rig = read_rig(folder / "rig.yaml")
    expected = Stream(Setup(rig=rig)).measure(shots[0]).line
    early = [searched.stripes_of(image) for image in laser_images(shots[0], len(rig.lasers.names))]
    found = iter(early)

    measured = Stream(Setup(rig=rig), early=lambda _: next(found)).measure(shots[0])

    assert None not in early
    assert next(found, None) is None  # each was asked for
    assert_same([recorded(pose_record(measured.line))], [recorded(pose_record(expected))])
