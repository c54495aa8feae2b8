"""The replay of recorded shots: one HTML page with its own timeline, plots and three-dimensional view.

The page loads nothing: pictures and numbers are in it, and its content security policy forbids requests.
"""

import base64
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields
from html import escape
from importlib.resources import files
from string import Template
from typing import Any

import cv2
import numpy as np

from ringpose.console import drawing
from ringpose.errors import DataError
from ringpose.report.overlay import pose_in_camera_frame, pose_texts
from ringpose.types.arrays import Array, Float64, UInt8
from ringpose.types.image import ALL_LASERS
from ringpose.types.options import PoseFrame
from ringpose.types.points import PointCloud
from ringpose.types.pose import PoseLine, RingPose
from ringpose.types.rig import Rig
from ringpose.types.truth import Truth

WIDTH_PX = 800
"""Width of the pictures, at most."""

JPEG_QUALITY = 80

UNMEASURED = "unmeasured"
"""Status of a shot without a pose line."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ReplayShot:
    """One shot of a replay."""

    name: str
    stamp_s: float
    jpeg: bytes
    """Picture of the shot."""
    line: PoseLine | None = None
    truth: Truth | None = None
    """The truth at the time at which the pose holds."""
    errors: Mapping[str, float] = field(default_factory=dict)
    """Errors of the pose, as `ringpose bench` names and computes them."""
    track: PoseLine | None = None
    """The track after this shot, in the camera frame; its reason is its validity and what became of the measurement."""
    camera_from_cloud: Float64[Array, "4 4"] | None = None
    """Where a point cloud is at the time of this shot; None if that is not known."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ReplayCloud:
    """A point cloud that is shown with the shots."""

    cloud: PointCloud

    @property
    def by_shot(self) -> bool:
        """Whether each shot shows its own points only: those in a frame that moves with camera or tool."""
        return self.cloud.frame is not PoseFrame.BASE

    def number_of(self, shot: ReplayShot) -> int | None:
        """The number of a shot in the cloud; -1 if it has no points there, None if all points are shown with it."""
        if not self.by_shot:
            return None
        return self.cloud.shots.index(shot.name) if shot.name in self.cloud.shots else -1

    def points_m(self, shots: Sequence[ReplayShot]) -> Float64[Array, "point xyz=3"]:
        """The points in the camera frame of the first shot whose place in the cloud is known."""
        place = next((shot.camera_from_cloud for shot in shots if shot.camera_from_cloud is not None), None)
        if place is None:
            return np.zeros((0, 3))
        return np.asarray(self.cloud.position_m @ place[:3, :3].T + place[:3, 3])


def times_s(shots: Sequence[ReplayShot]) -> list[float]:
    """Time of each shot since the first one; half a second apart where the stamps do not increase."""
    stamps_s = np.array([shot.stamp_s for shot in shots])
    if not are_timed(shots):
        stamps_s = 0.5 * np.arange(len(shots))
    return [float(stamp_s) for stamp_s in stamps_s - stamps_s[0]]


def are_timed(shots: Sequence[ReplayShot]) -> bool:
    """Whether the stamps of the shots increase."""
    stamps_s = np.array([shot.stamp_s for shot in shots])
    return bool(np.isfinite(stamps_s).all() and (np.diff(stamps_s) > 0).all())


def replay_picture(overlay: UInt8[Array, "row column 3"]) -> bytes:
    """The overlay of a shot as a smaller JPEG."""
    factor = min(1.0, WIDTH_PX / overlay.shape[1])
    small = cv2.resize(overlay, None, fx=factor, fy=factor, interpolation=cv2.INTER_AREA)
    return bytes(cv2.imencode(".jpg", small, (cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY))[1].tobytes())


def replay_page(shots: Sequence[ReplayShot], rig: Rig, title: str, cloud: ReplayCloud | None = None) -> str:
    """The complete page."""
    if not shots:
        raise DataError("the replay", "has no shots")
    poses = [None if shot.line is None else pose_in_camera_frame(shot.line, rig) for shot in shots]
    about = drawing.bounds(
        [*poses, *(shot.truth for shot in shots)], drawing.NOTHING if cloud is None else cloud.points_m(shots)
    )
    data = {
        "middle_m": about.middle_m.tolist(),
        "radius_m": about.radius_m,
        "elements": [_values_of(element) for element in drawing.rig_elements(rig, ALL_LASERS, about.target_m)],
        "legend": _legend(shots, poses, rig),
        "times_s": times_s(shots),
        "timed": are_timed(shots) and len(shots) > 1,
        "cloud": [] if cloud is None else _cloud_values(cloud),
        "shots": [_shot_values(shot, pose, rig, cloud) for shot, pose in zip(shots, poses, strict=True)],
        "plots": _plots(shots, poses),
    }
    text = json.dumps(data, allow_nan=False).replace("<", "\\u003c")  # cannot end the script element
    template = Template(files("ringpose.console").joinpath("replay.html").read_text(encoding="utf-8"))
    return template.substitute(title=escape(title), data=text)


def _legend(shots: Sequence[ReplayShot], poses: Sequence[RingPose | None], rig: Rig) -> list[dict[str, str]]:
    """What the colours of the three-dimensional view mean, of the rig and of what some shot has."""
    estimate = (
        ("estimate", drawing.RING_STYLES["pose"].color),
        ("grasp point", drawing.GRASP_COLOR),
        (f"centre, {drawing.CENTER_SIGMAS:g} sigma", drawing.CENTER_COLOR),
    )
    entries = estimate if any(pose is not None for pose in poses) else ()
    if any(shot.truth is not None for shot in shots):
        entries = (*entries, ("truth, dashed", drawing.RING_STYLES["truth"].color))
    if any(shot.track is not None for shot in shots):
        entries = (*entries, ("track, dotted", drawing.RING_STYLES["track"].color))
    lasers = ((f"laser {name}", drawing.laser_color(laser)) for laser, name in enumerate(rig.lasers.names))
    return [{"text": text, "color": _css(color)} for text, color in (*entries, *lasers)]


def _cloud_values(cloud: ReplayCloud) -> list[dict[str, Any]]:
    """The points of each laser, rounded to 0.1 mm, and the numbers of their shots if these show their own only."""
    return [
        {
            "color": _css(points.color),
            "points_mm": np.round(1e3 * points.points_m, 1).ravel().tolist(),
            "shot": cloud.cloud.shot[cloud.cloud.laser == laser].tolist() if cloud.by_shot else [],
        }
        for laser, points in zip(np.unique(cloud.cloud.laser), drawing.cloud_points(cloud.cloud), strict=True)
    ]


def _shot_values(shot: ReplayShot, pose: RingPose | None, rig: Rig, cloud: ReplayCloud | None) -> dict[str, Any]:
    track = None if shot.track is None else shot.track.pose
    return {
        "name": shot.name,
        "status": UNMEASURED if shot.line is None else shot.line.status,
        "picture": f"data:image/jpeg;base64,{base64.b64encode(shot.jpeg).decode('ascii')}",
        "texts": _texts(shot, pose),
        "camera_from_cloud": None if shot.camera_from_cloud is None else shot.camera_from_cloud[:3].tolist(),
        "in_cloud": None if cloud is None else cloud.number_of(shot),
        "elements": [_values_of(element) for element in drawing.recorded_elements(rig, pose, shot.truth, track)],
    }


def _values_of(element: drawing.Element | drawing.Path | drawing.Circle) -> dict[str, Any]:
    """The attributes of an element and its kind, as the script of the page expects them."""
    values: dict[str, Any] = {"kind": type(element).__name__.lower()}
    for name in (each.name for each in fields(element)):
        value = getattr(element, name)
        if name == "strokes":
            value = [_values_of(stroke) for stroke in value]
        elif name == "color":
            value = _css(value)
        values[name] = value.tolist() if isinstance(value, np.ndarray) else value
    return values


def _css(color: drawing.Color) -> str:
    return "#{:02x}{:02x}{:02x}".format(*color)


def _texts(shot: ReplayShot, pose: RingPose | None) -> list[tuple[str, str]]:
    """What is known about a shot, in words."""
    line = shot.line
    texts = [("pose", "not measured")]
    if line is not None:
        texts = [("flags", ", ".join(line.flag_names)), ("reason", line.reason or "")]
    for text in [] if pose is None else pose_texts(pose):
        name, _, value = text.partition(" ")
        texts.append(("normal", text) if name == "pitch" else (name, value))
    if shot.track is not None:
        texts.append(("track", shot.track.reason or ""))
        if shot.track.pose is not None:
            texts.append(("track: centre", pose_texts(shot.track.pose)[1].partition(" ")[2]))
    for name, error in shot.errors.items():
        in_unit = f"{np.degrees(error):.4f} deg" if name.endswith("_rad") else f"{1e3 * error:.3f} mm"
        texts.append((f"error: {_title(name)}", in_unit))
    return [(name, text.replace("+-", "±")) for name, text in texts if text]


def _title(name: str) -> str:
    """The name of an error without its unit, which is another in the page."""
    return name.rpartition("_")[0].replace("_", " ").replace("center", "centre")


def _plots(shots: Sequence[ReplayShot], poses: Sequence[RingPose | None]) -> list[dict[str, Any]]:
    """Centre and grasp point with standard deviations, normal, and the errors where the truth is known.

    None without a pose: their axes would have no meaning.
    """
    if all(pose is None for pose in poses):
        return []
    plots = []
    for title, key in (("centre (mm)", "center"), ("grasp point (mm)", "grasp")):
        points_m = [None if pose is None else getattr(pose, f"{key}_m") for pose in poses]
        covariances = [None if pose is None else getattr(pose, f"covariance_{key}_m2") for pose in poses]
        sigmas_m = [None if m2 is None else np.sqrt(np.maximum(np.diagonal(m2), 0.0)) for m2 in covariances]
        plots.append(_plot(title, "xyz", 1e3, points_m, sigmas_m))
    angles_rad = [None if pose is None else (pose.pitch_rad, pose.yaw_rad) for pose in poses]
    plots.append(_plot("normal (deg)", ("pitch", "yaw"), np.degrees(1.0), angles_rad))
    for name in dict.fromkeys(name for shot in shots for name in shot.errors):
        factor, unit = (np.degrees(1.0), "deg") if name.endswith("_rad") else (1e3, "mm")
        errors = [(shot.errors[name],) if name in shot.errors else None for shot in shots]
        plots.append(_plot(f"error: {_title(name)} ({unit})", ("",), factor, errors))
    return plots


Values = Sequence[Sequence[float] | Float64[Array, "part"] | None]
"""The parts of a quantity in each shot; None where there is no pose."""


def _plot(
    title: str, names: Sequence[str], factor: float, values: Values, sigmas: Values | None = None
) -> dict[str, Any]:
    """A plot with a curve for each part of a quantity, in another unit."""
    series: list[dict[str, Any]] = []
    for part, name in enumerate(names):
        series.append({"name": name})
        for key, of_shots in {"values": values, "sigmas": sigmas}.items():
            if of_shots is not None:
                series[-1][key] = [None if values is None else _number(factor * values[part]) for values in of_shots]
    return {"title": title, "series": series}


def _number(value: float | None) -> float | None:
    return None if value is None or not np.isfinite(value) else float(value)
