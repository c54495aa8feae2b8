"""Computes a study and writes its results (ringpose-bench(1)); the worst shots are computed again for the report."""

from collections.abc import Iterable, Iterator
from dataclasses import replace
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from time import monotonic
from typing import Any

import numpy as np

from ringpose.bench.capture.score import CaptureOutcome, captures_text, missed_limits, refuted_claims
from ringpose.bench.capture.study import capture_rows, line_of_row
from ringpose.bench.study import executors
from ringpose.bench.study.executors import Done
from ringpose.bench.study.shots import StudyShot, failed_rows, setting_of, study_rows, study_shot
from ringpose.bench.study.table import finding, worst_shots
from ringpose.files.studies.results import ResultFolder
from ringpose.report.page import Picture
from ringpose.simulate.pipeline import simulated_boards
from ringpose.types.image import Shot
from ringpose.types.options import PlanesMethod
from ringpose.types.rig import Rig
from ringpose.types.scene import Scene
from ringpose.types.study import Row, Study, StudyMethod
from ringpose.types.truth import Truth

PART_S = (0.5, 10.0)
"""Time after which finished shots are written to a new part file, at first and later: what a killed study loses."""

PART_SHOTS = 5000
"""Number of shots after which they are written earlier."""

OVERLAYS = 4
"""Number of the worst shots whose images are in the report ..."""

MARGIN_PX = 150
"""... from so many pixels beside the stripes on the ring's face on."""


def metadata(study: Study, command: str) -> dict[str, Any]:
    """The data that identify the results of a study, and their provenance."""
    return {
        "ringpose": "study_results/1",
        "title": study.title,
        "study_sha256": study.sha256,
        **executors.software(),
        "seed": study.seed,
        "count": study.count,
        "shots": study.shots,
        "level": study.level,
        "factors": [factor.name for factor in study.factors],
        "methods": [method.value for method in study.methods],
        "rig_sha256": study.scene.rig.sha256,
        "files": [str(file) for file in study.files],
        "command": command,
        "started": datetime.now(UTC).isoformat(timespec="seconds"),
    }


def prepared(study: Study, folder: ResultFolder, jobs: int) -> Study:
    """The study with the rig by which its shots are measured.

    If the study asks for that, the rig is calibrated from simulated board views first, and kept in the folder.
    """
    from ringpose.files.rigs import read_rig, write_rig

    if not study.calibrate:
        return study
    rig_file = folder.folder / "calibrated-rig.yaml"
    if not rig_file.exists():
        write_rig(rig_file, calibrated_rig(study.scene, jobs))
    return replace(study, rig=read_rig(rig_file))


def calibrated_rig(scene: Scene, jobs: int = 1) -> Rig:
    """Camera and light planes with their joint covariance, estimated from the scene's board views.

    As by `calibrate-camera` and `calibrate-planes`; the scene has boards. DataError if too few of them are found.
    """
    from ringpose.calibrate.boards.diagnostics import NoBoard
    from ringpose.calibrate.boards.shots import BoardShots
    from ringpose.calibrate.camera.pipeline import assessed_camera
    from ringpose.calibrate.planes.pipeline import StripeShots
    from ringpose.calibrate.planes.quality import calibrated_rig as rig_of_planes

    assert scene.camera_boards is not None  # as read_study checks
    assert scene.plane_boards is not None
    true = scene.rig
    with BoardShots(scene.camera_boards.board) as boards:
        for shot, _ in simulated_boards(scene, scene.camera_boards, jobs=jobs):
            boards.add(shot)
    camera = assessed_camera(boards, camera_name=true.camera.camera_name).calibration.camera
    with BoardShots(scene.plane_boards.board) as boards:
        stripes = StripeShots(boards, camera, ",".join(true.lasers.names), None)
        for shot, _ in simulated_boards(scene, scene.plane_boards, jobs=jobs):
            if not isinstance(view := boards.add(shot), NoBoard):
                stripes.add(shot, view)
    rig = rig_of_planes(stripes.assessment(PlanesMethod.JOINT).calibration)
    # a calibration does not determine the positions of the projectors, which only the simulation of features needs
    return replace(rig, lasers=replace(rig.lasers, projector_m=true.lasers.projector_m))


def computed(
    study: Study, indices: list[int], jobs: int, scheduler: str | None, scheduler_file: Path | None
) -> Iterator[Done]:
    """Compute shots, in any order: by a cluster if a scheduler is given, else by processes."""
    if not indices:
        return iter(())
    executor = executors.in_this_process if jobs == 1 else executors.by_processes(jobs)
    if scheduler is not None or scheduler_file is not None:
        executor = executors.by_cluster(scheduler, scheduler_file)
    rows = study_rows if study.capture is None else capture_rows
    return executors.computed(executor, partial(rows, study), indices)


def write_finished(study: Study, folder: ResultFolder, done: Iterable[Done]) -> None:
    """Write shots as they are finished; what is finished survives an interrupt."""
    unwritten: dict[int, list[Row]] = {}
    begun_s = last_s = monotonic()
    try:
        for shot in done:
            rows = shot.rows
            unwritten[shot.shot] = failed_rows(study, shot.shot, "killed its worker") if rows is None else rows
            now_s = monotonic()
            due_s = last_s + min(max(PART_S[0], 0.1 * (now_s - begun_s)), PART_S[1])
            if len(unwritten) >= PART_SHOTS or now_s > due_s:
                folder.add(unwritten)
                unwritten, last_s = {}, now_s
    finally:
        if unwritten:
            folder.add(unwritten)


def written_captures(study: Study, folder: ResultFolder) -> tuple[str, list[str]]:
    """Write captures.jsonl of a study of captures; returns its table, and a message for each limit that is missed."""
    from ringpose.files import atomic
    from ringpose.files.records import line_of
    from ringpose.files.records.captures import RECORD

    names = [factor.name for factor in study.factors]
    lines, failed = [], 0
    with atomic.replacing(folder.folder / "captures.jsonl", force=True) as stream:
        for row in folder.rows():
            if row["outcome"] == CaptureOutcome.ERROR:
                failed += 1
                continue
            lines.append(line_of_row(row, names))
            stream.write(line_of(RECORD.write(lines[-1])).encode())
    by = [factor.name for factor in study.grid if len(factor.values) > 1]
    missed = [*missed_limits(study.limits, study.methods[0].value, lines, by), *refuted_claims(lines)]
    heading = f"{study.title}: {study.shots} runs ({study.level}), seed {study.seed}"
    table = captures_text(lines, by)
    return f"{heading}\n\n{table}", [*missed, *([f"{failed} runs could not be computed"] if failed else [])]


def _worst(study: Study, folder: ResultFolder, count: int) -> Iterator[tuple[int, StudyShot]]:
    """The shots with the largest errors of the main method, computed again."""
    for index in worst_shots(folder.rows(), _main_method(study), count):
        yield index, study_shot(study, index, setting_of(study, index))


def _main_method(study: Study) -> str:
    return (StudyMethod.ML if StudyMethod.ML in study.methods else study.methods[0]).value


def write_worst(study: Study, folder: ResultFolder, count: int) -> None:
    """Write the shots with the largest errors, with their truth, as a data set for `ringpose bench`."""
    from ringpose.files.images.simulations import SimulationFolder

    content = "shots" if study.level == "images" else "detections"
    rig = study.rig or study.scene.rig
    kept = SimulationFolder(folder.folder / "worst", rig, force=True, inputs=[], content=content)
    for _, shot in _worst(study, folder, count):
        source = shot.run[-1]
        if isinstance(source, Shot):
            kept.add(source, shot.truth)
        else:
            kept.add_detection(source, shot.truth)


def pictures_of_worst(study: Study, folder: ResultFolder) -> list[Picture]:
    """Pictures of the shots with the largest errors, with what was detected; none if features are drawn, not images."""
    import cv2

    from ringpose.measure.stream import Setup
    from ringpose.report.overlay import overlay, picture_of

    if study.level == "features":
        return []
    method, pictures = _main_method(study), []
    worst = set(worst_shots(folder.rows(), method, OVERLAYS))
    rows = {row["shot"]: row for row in folder.rows() if row["method"] == method and row["shot"] in worst}
    for index, shot in _worst(study, folder, OVERLAYS):
        source = shot.run[-1]
        assert isinstance(source, Shot)
        picture = overlay(picture_of(source), Setup(rig=shot.scene.rig).detection(source), rig=shot.scene.rig)
        png = cv2.imencode(".png", picture[_around_stripes(shot.truth, picture.shape)])[1]
        setting = ", ".join(f"{name} {value}" for name, value in shot.setting.items())
        caption = f"Shot {index} ({method}): {finding(rows[index])}; {setting}"
        pictures.append(Picture(png=png.tobytes(), caption=caption))
    return pictures


def _around_stripes(truth: Truth, shape: tuple[int, ...]) -> tuple[slice, slice]:
    """Rows and columns of an image around the true stripes on the face, with a margin; all if no stripe is visible."""
    points_px = np.full((1, 2), np.nan) if truth.break_points_px is None else truth.break_points_px.reshape(-1, 2)
    if not np.isfinite(points_px).any():
        return slice(None), slice(None)
    low, high = np.nanmin(points_px, axis=0) - MARGIN_PX, np.nanmax(points_px, axis=0) + MARGIN_PX
    (left, top), (right, bottom) = np.maximum(low, 0).astype(int).tolist(), high.astype(int).tolist()
    return slice(top, min(bottom, shape[0])), slice(left, min(right, shape[1]))
