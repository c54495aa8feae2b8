"""Overlay images of `ringpose detect` and `ringpose pose`, one PNG file a shot, and the report of poses."""

from dataclasses import replace
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING

from ringpose.cli import messages
from ringpose.cli.app import check_report
from ringpose.errors import DataError, RingposeError
from ringpose.files import atomic
from ringpose.files.io import provenance, write_page

if TYPE_CHECKING:
    from ringpose.measure.stream import Measured
    from ringpose.report.page import Picture
    from ringpose.types.arrays import Array, UInt8
    from ringpose.types.pose import PoseLine
    from ringpose.types.rig import Rig


class OverlayFolder:
    """A folder of overlay images; the second of two shots with the same name is rejected."""

    def __init__(self, folder: Path, *, force: bool) -> None:
        self._folder = atomic.make_folder(folder)
        self._force = force
        self._names: set[str] = set()

    def write(self, name: str, picture: "UInt8[Array, 'row column 3']") -> None:
        """Write the picture of one shot."""
        from ringpose.files.images.codecs import write_image

        if Path(name).name != name:
            raise DataError(name, "cannot be the name of a file in the folder of overlays", "rename the shot")
        if name in self._names:
            raise DataError(name, "an earlier shot has this name; its overlay would be replaced", "rename one of them")
        self._names.add(name)
        write_image(self._folder / f"{name}.png", picture, force=self._force)


WORST_SHOTS = 6
"""Number of shots that a report shows."""

REPORT_WIDTH_PX = 900
"""Width of their pictures, at most."""


class PosePictures:
    """Overlays and report of `ringpose pose`; a picture is drawn after the line of its shot has been written.

    The report is written at the end of the `with` block, also after an interrupt, which is how a live measurement ends.
    """

    def __init__(self, rig: "Rig", rig_file: Path, folder: Path | None, report: Path | None, *, force: bool) -> None:
        check_report(report, force)
        self._rig_file = rig_file
        self._rig, self._report, self._force = rig, report, force
        self._overlays = None if folder is None else OverlayFolder(folder, force=force)
        self._lines: list[PoseLine] = []
        self._worst: list[tuple[tuple[int, float], int, Picture]] = []
        """Badness, number and picture of the worst shots, the worst first."""

    def __enter__(self) -> "PosePictures":
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        try:
            self._write_report()
        except RingposeError as problem:
            if error is None:
                raise
            messages.error(problem)  # the error that ended the block is reported, too

    def add(self, measured: "Measured") -> None:
        """Draw the overlay of a measured shot, and add its line to the report."""
        line = measured.line
        is_bad = self._report is not None and self._is_among_worst(line)
        if self._overlays is not None or is_bad:
            picture = self._drawn(measured)
            if self._overlays is not None:
                self._overlays.write(line.shot, picture)
            if is_bad:
                self._keep_worst(line, picture)
        if self._report is not None:
            self._lines.append(replace(line, measurement=None, plane_evidence=None, priors=None))

    def _write_report(self) -> None:
        if self._report is None:
            return
        from ringpose.report.poses import pose_report

        worst = [picture for _, _, picture in self._worst]
        of_run = provenance([])
        about = [f"Rig: {self._rig_file}, SHA-256 {self._rig.sha256}.", f"Command: {of_run['command']}"]
        about.append(f"Written by ringpose {of_run['version']} at {of_run['time']}.")
        html = pose_report(self._lines, worst, f"Poses of {len(self._lines)} shots", about)
        write_page(self._report, html, force=self._force)

    def _drawn(self, measured: "Measured") -> "UInt8[Array, 'row column 3']":
        import numpy as np

        from ringpose.report.overlay import overlay, picture_of

        assert measured.detection is not None  # as with a single process
        camera = self._rig.camera
        dark = np.zeros((camera.image_height, camera.image_width), np.uint8)  # a detection has no image
        picture = dark if measured.shot is None else picture_of(measured.shot)
        return overlay(picture, measured.detection, measured.line, self._rig)

    def _is_among_worst(self, line: "PoseLine") -> bool:
        from ringpose.report.poses import badness

        return len(self._worst) < WORST_SHOTS or badness(line) > self._worst[-1][0]

    def _keep_worst(self, line: "PoseLine", picture: "UInt8[Array, 'row column 3']") -> None:
        import cv2

        from ringpose.pose.advice import remarks_on
        from ringpose.report.page import Picture
        from ringpose.report.poses import badness

        factor = min(1.0, REPORT_WIDTH_PX / picture.shape[1])
        small = cv2.resize(picture, None, fx=factor, fy=factor, interpolation=cv2.INTER_AREA)
        png = cv2.imencode(".png", small)[1].tobytes()
        entry = (badness(line), len(self._lines), Picture(png=png, caption=f"{line.shot}: {remarks_on(line)}"))
        self._worst = sorted([*self._worst, entry], key=lambda each: each[:2], reverse=True)[:WORST_SHOTS]
