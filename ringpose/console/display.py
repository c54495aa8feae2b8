"""What the pages of the console and of recorded data have in common: controls, pictures, text and plots."""

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import viser
from viser import uplot

from ringpose.console.controls import Choice, Control, Number, Switch, Value
from ringpose.estimate.covariance import standard_deviation
from ringpose.geometry.rotations import facing_angles
from ringpose.pose.advice import remarks_on
from ringpose.report.overlay import pose_texts
from ringpose.types.pose import PoseLine, RingPose, RingVelocity
from ringpose.types.truth import Truth

PLOTS = (
    ("error of the centre (mm)", "center_m", 1e3),
    ("error of the normal (deg)", "normal_rad", 180 / np.pi),
    ("error of the grasp point (mm)", "grasp_m", 1e3),
)
"""Title, error, and factor of its unit."""


class Field:
    """A control, and a line below it that says why a value was not taken."""

    def __init__(self, server: viser.ViserServer, control: Control) -> None:
        self._control = control
        self._handle: Any = _handle_of(server, control)
        self._remark = server.gui.add_markdown("", visible=False)
        self.is_refused = False
        """Whether what was last in the field was not taken."""

    @property
    def value(self) -> object:
        """What is in the field, which need not be a value that the control takes."""
        return self._handle.value

    def show(self, value: Value) -> None:
        """Put a value into the field."""
        self._handle.value = value
        self.report("")

    def extended_to(self, high: float) -> Number:
        """The control with another end of its range of numbers, which the field now has, too."""
        assert isinstance(self._control, Number)
        self._control = replace(self._control, high=high)
        self._handle.max = high
        return self._control

    def on_update(self, action: Callable[[], None]) -> None:
        """Act when a browser has changed the value."""
        self._handle.on_update(lambda event: None if event.client is None else action())

    def report(self, refusal: str) -> None:
        """Show why what is in the field was not taken; empty if it was.

        A browser replaces a number out of range by the nearest limit when the field is left: then the range is shown.
        """
        control = self._control
        if not refusal and self.is_refused and isinstance(control, Number):
            is_limit = self.value in (control.low, control.high)
            refusal = f"limited to {control.low:g} to {control.high:g}" if is_limit else ""
        self.is_refused = bool(refusal)
        text = f"*{plain(refusal)}*" if refusal else ""
        if self._remark.content != text:
            self._remark.content, self._remark.visible = text, bool(text)


def _handle_of(server: viser.ViserServer, control: Control) -> Any:
    gui, label = server.gui, encodable(control.label)
    hint = control.hint or None
    if isinstance(control, Number):
        within = f"{control.low:g} to {control.high:g}"
        hint = f"{control.hint} Range: {within}." if control.hint else within
        return gui.add_slider(label, control.low, control.high, control.step, control.initial, hint=hint)
    if isinstance(control, Choice):
        return gui.add_dropdown(label, control.options, initial_value=control.initial, hint=hint)
    if isinstance(control, Switch):
        return gui.add_checkbox(label, control.initial, hint=hint)
    return gui.add_text(label, control.initial, hint=hint)


def plain(text: str) -> str:
    """Text that a page shows as it is: without Markdown, HTML and line breaks, whatever a file contains."""
    return re.sub(r"[!-/:-@\[-`{-~]", lambda match: f"&#{ord(match[0])};", " ".join(encodable(text).split()))


def encodable(text: str) -> str:
    """Text with a question mark for each lone surrogate, which would break the connection to every browser."""
    return text.encode("utf-8", "replace").decode("utf-8")


class ImagePanel:
    """An image in the panel, which is passed as JPEG."""

    def __init__(self, server: viser.ViserServer, label: str) -> None:
        self._handle = server.gui.add_image(np.zeros((120, 160, 3), np.uint8), label=label, format="jpeg")

    def show(self, jpeg: bytes, label: str | None = None) -> None:
        """Show this JPEG."""
        self._handle._data = jpeg  # the setter of `image` would encode again, and once for each place
        if label is not None:
            self._handle.label = encodable(label)


class Plots:
    """Errors of measurements over a band of one standard deviation that they report."""

    def __init__(self, server: viser.ViserServer, x_label: str) -> None:
        blank = (np.zeros(1),) * 4
        self._plots = [
            server.gui.add_uplot(
                blank,
                (
                    uplot.Series(label=x_label),
                    _points("error", "#4f8fef"),
                    uplot.Series(label="sigma", stroke="#d0604f", width=1, points={"show": False}),
                    uplot.Series(label="zero", stroke="#d0604f", width=0, points={"show": False}),
                ),
                bands=(uplot.Band(series=(2, 3), fill="rgba(208, 96, 79, 0.25)"),),
                title=title,
                scales={"x": uplot.Scale(time=False)},
                aspect=2.0,
            )
            for title, *_ in PLOTS
        ]

    def show(self, x: Sequence[float], rows: Sequence[tuple[float, ...]]) -> None:
        """Show a row for each measurement: error and standard deviation of each plot, as `plotted` returns them."""
        if not rows:
            return
        table, places = np.array(rows), np.array(x, dtype=np.float64)
        for number, plot in enumerate(self._plots):
            error, sigma = table[:, 2 * number], table[:, 2 * number + 1]
            known = np.isfinite(sigma)  # the band has no gaps
            plot.data = (places[known], error[known], sigma[known], 0.0 * sigma[known])


def csv_of(x_label: str, x: Sequence[float], rows: Sequence[tuple[float, ...]]) -> str:
    """What the plots show, as CSV; nothing where there is no value."""
    headings = [f"{part}{title}" for title, *_ in PLOTS for part in ("", "sigma of the ")]
    values = [
        [f"{value:.6g}" if np.isfinite(value) else "" for value in (at, *row)] for at, row in zip(x, rows, strict=True)
    ]
    return "".join(f"{','.join(row)}\n" for row in ([x_label, *headings], *values))


def comparison_html(pose: RingPose | None, truth: Truth) -> str:
    """Truth, estimate, standard deviation and error of each number of a pose as a table, in mm and degrees."""
    nan = float("nan")
    full = None if pose is None else pose.covariance
    center = None if pose is None else pose.covariance_center_m2
    tilts = nan if full is None or not np.isfinite(full[:2, :2]).all() else standard_deviation(full[:2, :2])
    rows: list[tuple[str, float, float, float]] = []
    for axis, name in enumerate("xyz"):
        sigma = nan if center is None else float(np.sqrt(center[axis, axis]))
        true = nan if truth.center_m is None else float(truth.center_m[axis])
        rows.append(
            (
                f"centre {name} (mm)",
                1e3 * true,
                1e3 * (nan if pose is None else float(pose.center_m[axis])),
                1e3 * sigma,
            )
        )
    true_angles = (nan, nan) if truth.normal is None else facing_angles(truth.normal)
    angles = (nan, nan) if pose is None else (pose.pitch_rad, pose.yaw_rad)
    for name, true, angle in zip(("pitch", "yaw"), true_angles, angles, strict=True):
        true_deg, angle_deg, tilt_deg = np.degrees([true, angle, tilts]).tolist()
        rows.append((f"{name} (deg)", true_deg, angle_deg, tilt_deg))
    for name, true_m, place in (("inner", truth.radius_inner_m, 5), ("outer", truth.radius_outer_m, 6)):
        radius_m = nan if pose is None else float(getattr(pose, f"radius_{name}_m"))
        sigma = nan if full is None else float(np.sqrt(full[place, place]))
        rows.append((f"{name} radius (mm)", 1e3 * (nan if true_m is None else true_m), 1e3 * radius_m, 1e3 * sigma))
    cells = [[name, *map(_cell, (true, value, sigma, value - true))] for name, true, value, sigma in rows]
    lines = "".join(f"<tr>{''.join(f'<td>{cell}</td>' for cell in row)}</tr>" for row in cells)
    heads = "".join(f"<th>{head}</th>" for head in ("", "truth", "estimate", "sigma", "error"))
    style = (
        "width:calc(100% - 1.2em);margin:0 0.6em;text-align:right;font-size:0.85em;font-variant-numeric:tabular-nums"
    )
    return f'<table style="{style}"><tr>{heads}</tr>{lines}</table>'


def _cell(value: float) -> str:
    text = f"{value:.2f}" if np.isfinite(value) else "-"
    return "0.00" if text == "-0.00" else text


def _points(label: str, color: str) -> uplot.Series:
    """A plot series of points without lines, which would join the measurements on both sides of a missing one."""
    return uplot.Series(label=label, stroke=color, width=0, points={"show": True, "size": 4, "fill": color})


def plotted(pose: RingPose | None, errors: Mapping[str, float]) -> tuple[float, ...]:
    """Error and reported standard deviation of each plot, in its unit; NaN where there is none."""
    tilts = None if pose is None or pose.covariance is None else pose.covariance[:2, :2]
    covariances = {
        "center_m": None if pose is None else pose.covariance_center_m2,
        "normal_rad": tilts,
        "grasp_m": None if pose is None else pose.covariance_grasp_m2,
    }
    row: list[float] = []
    for _, name, factor in PLOTS:
        covariance = covariances[name]
        sigma = np.nan if covariance is None else float(np.sqrt(np.trace(covariance)))
        row += [factor * errors.get(name, np.nan), factor * sigma]
    return tuple(row)


def line_text(line: PoseLine | None, about: str, errors: Mapping[str, float], outdated: str = "") -> str:
    """Status, flags, reason, pose and errors of a measurement; `about` names what was measured.

    `outdated` says what has changed since, if it is no longer that of the target; its status then is what it was.
    """
    if line is None:
        return f"**not measured** ({plain(about)})"
    rows = [f"**outdated**: {plain(outdated)}", f"was {line.status} ({plain(about)})"] if outdated else []
    rows = rows or [f"**{line.status}** ({plain(about)})"]
    if (remarks := remarks_on(line)) != line.status:
        rows.append(plain(remarks))
    if line.pose is not None:
        rows += [plain(text.replace("+-", "±")) for text in pose_texts(line.pose)]
    shown = [
        f"{name} {factor * errors[key]:.3f}{unit}"
        for name, key, factor, unit in (
            ("centre", "center_m", 1e3, " mm"),
            ("grasp", "grasp_m", 1e3, " mm"),
            ("normal", "normal_rad", 180 / np.pi, "°"),
        )
        if key in errors
    ]
    return "  \n".join([*rows, f"errors: {', '.join(shown)}" if shown else "no errors: nothing to compare"])


def track_text(pose: RingPose | None, velocity: RingVelocity | None, status: str, error_m: float = np.nan) -> str:
    """One line on a track: its status, centre, speed and rate, and the error of its centre if it is known."""
    status = plain(status)
    if pose is None:
        return f"track: {status}"
    x, y, z = 1e3 * pose.center_m
    parts = [f"track: {status}, centre {x:.2f}, {y:.2f}, {z:.2f} mm"]
    if velocity is not None:
        rate_deg_s = np.degrees(np.linalg.norm(velocity.rate_rad_s))
        parts.append(f"{1e3 * np.linalg.norm(velocity.center_m_s):.1f} mm/s, {rate_deg_s:.2f} deg/s")
    if np.isfinite(error_m):
        parts.append(f"error of the centre {1e3 * error_m:.3f} mm")
    return ", ".join(parts)
