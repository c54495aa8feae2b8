"""The page that `ringpose calibrate-planes --report` writes."""

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes

from ringpose.calibrate.acceptance import PLANES_LIMITS
from ringpose.calibrate.planes.covariance import worst_depth_sd_m
from ringpose.calibrate.planes.quality import PlanesAssessment, calibrated_rig, plane_angles
from ringpose.geometry.rays import project
from ringpose.geometry.rotations import angle_between
from ringpose.report.figures import canvas, drawn, png_of
from ringpose.report.page import Picture, Section, page, verdict_section
from ringpose.report.views import DrawnView, space_picture, views_picture
from ringpose.types.arrays import Array, UInt8
from ringpose.types.calibration import LaserCalibration, PlanesCalibration, StripeView
from ringpose.types.table import Table

_BIN_SHARE = 0.04
"""Bin width of residuals along a stripe, in tangents of the viewing angle."""

_MIN_COUNT = 5
"""Minimum number of centres in a bin."""

_DEPTHS = 25
"""Number of distances at which the uncertainty is plotted."""


def planes_report(
    assessment: PlanesAssessment,
    views: Sequence[StripeView],
    thumbnails: Mapping[str, UInt8[Array, "row column"] | None],
) -> str:
    """HTML page: verdict, planes, the views with their small images by name, plots of residuals and uncertainty."""
    calibration = assessment.calibration
    boards = _drawn_views(calibration, views)
    pictures = [_by_distance(calibration), _along_stripes(calibration)]
    if calibration.covariance is not None:
        pictures.append(_depths(calibration))
    left_out = [list(entry) for entry in (*assessment.without_board, *calibration.contradicting, *calibration.remarks)]
    sections = [
        verdict_section(assessment.verdict),
        Section(
            title="Light planes: normal . point = distance, camera frame",
            table=_planes(calibration, assessment.paper),
            pictures=[space_picture(boards, calibration.camera, calibration.lasers)],
        ),
        Section(
            title="Views",
            table=_views(calibration),
            pictures=[views_picture(boards, calibration.camera, thumbnails)],
        ),
        Section(title="Residuals and uncertainty", pictures=pictures),
    ]
    if angles := plane_angles(calibration):
        rows = [
            [" to ".join(one["lasers"]), *(_degrees(one[key]) for key in ("angle_rad", "sd_rad"))] for one in angles
        ]
        table = Table(headings=("angle between", "degrees", "standard deviation"), rows=rows)
        sections.insert(2, Section(title="Angles", table=table))
    if left_out:
        sections.append(Section(title="Left out or missing", table=Table(headings=("view", "why"), rows=left_out)))
    return page("Calibration of the light planes", sections)


def _drawn_views(calibration: PlanesCalibration, views: Sequence[StripeView]) -> list[DrawnView]:
    """The views whose boards have a pose, with the residuals of their corners and the stripes used, by laser."""
    poses = {pose.name: pose for pose in calibration.poses}
    boards = []
    for view in views:
        if (pose := poses.get(view.board.name)) is not None:
            points = view.board.points_board_m @ pose.rotation.T + pose.translation_m
            residual_px = view.board.points_px - project(points, calibration.camera)
            nothing_left_out = np.zeros(len(residual_px), dtype=np.bool_)
            stripes = [
                [own.points for own in laser.views if own.name == view.board.name] for laser in calibration.lasers
            ]
            boards.append(
                DrawnView(
                    board=view.board,
                    pose=pose,
                    residual_px=residual_px,
                    left_out=nothing_left_out,
                    stripes_px=[
                        project(np.concatenate([*own, np.empty((0, 3))]), calibration.camera) for own in stripes
                    ],
                )
            )
    return boards


def _planes(calibration: PlanesCalibration, paper: PlanesCalibration | None) -> Table:
    """Each plane with its uncertainty, its residuals, its bow, and its difference to the paper's method."""
    deviations = {} if calibration.covariance is None else calibration.covariance.standard_deviations
    rows = []
    for index, laser in enumerate(calibration.lasers):
        tilt_rad, distance_sd_m = (
            max((deviations.get(f"{laser.name}.{name}", np.nan) for name in names), default=np.nan)
            for names in (("tilt_1", "tilt_2"), ("distance",))
        )
        rows.append(
            [
                laser.name,
                " ".join(f"{part:.5f}" for part in laser.normal),
                f"{1e3 * laser.distance_m:.3f}",
                _degrees(float(tilt_rad)),
                _micrometres(float(distance_sd_m)),
                _micrometres(laser.rms_m),
                _micrometres(laser.held_out_rms_m),
            ]
        )
        if calibration.bows:
            bow = calibration.bows.get(laser.name)
            rows[-1].append("flat" if bow is None else f"{bow.per_rad:.5f} ± {bow.sd_per_rad:.5f}")
        if paper is not None:
            rows[-1].append(_degrees(float(angle_between(laser.normal, paper.lasers[index].normal))))
    headings = ["laser", "normal", "distance mm", "tilt sd deg", "distance sd um", "rms um", "held out um"]
    headings += ["bow 1/rad"] if calibration.bows else []
    headings += [] if paper is None else ["to the paper's method deg"]
    return Table(headings=headings, rows=rows)


def _degrees(angle_rad: float) -> str:
    return f"{np.degrees(angle_rad):.4f}" if np.isfinite(angle_rad) else "unknown"


def _views(calibration: PlanesCalibration) -> Table:
    rows = [
        [
            laser.name,
            view.name,
            f"{view.distance_m:.3f}",
            str(len(view.points)),
            _micrometres(view.rms_m),
            _micrometres(view.held_out_rms_m),
        ]
        for laser in calibration.lasers
        for view in laser.views
    ]
    return Table(headings=("laser", "view", "distance m", "points", "rms um", "held out um"), rows=rows)


def _micrometres(value_m: float) -> str:
    return f"{1e6 * value_m:.0f}" if np.isfinite(value_m) else "unknown"


def _by_distance(calibration: PlanesCalibration) -> Picture:
    figure = canvas(10, 3.2 * len(calibration.lasers))
    axes = figure.subplots(len(calibration.lasers), 1, sharex=True, squeeze=False)[:, 0]
    for axis, laser in zip(axes, calibration.lasers, strict=True):
        depth = np.concatenate([view.points[:, 2] for view in laser.views])
        residual = np.concatenate([view.residual_m for view in laser.views])
        axis.plot(depth, 1e6 * residual, ".", markersize=1.5, color="tab:blue", alpha=0.5, label="centres")
        middle = [view.distance_m for view in laser.views]
        held_out = [1e6 * float(np.mean(view.held_out_m)) for view in laser.views]
        axis.plot(middle, held_out, "o", color="tab:red", label="mean of a view, held out")
        axis.axhline(0, color="black", linewidth=0.6)
        _limits(
            axis, 1e6 * PLANES_LIMITS["held_out_rms_m"].good * float(np.mean(middle)), "good limit of the held-out rms"
        )
        axis.set_ylabel(f"{drawn(laser.name)}: residual (um)")
    figure.legend(*axes[0].get_legend_handles_labels(), loc="outside upper center", ncols=3)
    axes[-1].set_xlabel("distance (m)")
    caption = "Distances of the stripe centres from their light plane, against depth; a trend indicates a wrong camera."
    return Picture(png=png_of(figure), caption=caption)


def _along_stripes(calibration: PlanesCalibration) -> Picture:
    figure = canvas(10, 3.2 * len(calibration.lasers))
    axes = figure.subplots(len(calibration.lasers), 1, sharex=True, squeeze=False)[:, 0]
    shots = list(dict.fromkeys(drawn(view.name) for laser in calibration.lasers for view in laser.views))
    styles = {name: (f"C{index % 10}", "-" if index < 10 else "--") for index, name in enumerate(shots)}
    for axis, laser in zip(axes, calibration.lasers, strict=True):
        for view, (position, mean) in zip(laser.views, _averages(laser), strict=True):
            color, stroke = styles[drawn(view.name)]
            axis.plot(position, 1e6 * mean, stroke, linewidth=1, label=drawn(view.name), color=color)
        axis.axhline(0, color="black", linewidth=0.6)
        axis.set_ylabel(f"{drawn(laser.name)}: residual (um)")
    lines = {str(line.get_label()): line for axis in axes for line in axis.get_lines()}
    figure.legend([lines[name] for name in shots], shots, loc="outside upper center", fontsize=8, ncols=6)
    axes[-1].set_xlabel("direction along the stripe (tangent of the angle from the optical axis)")
    caption = "The same along the stripes, averaged; similar curves indicate wrong distortion or a bent board."
    return Picture(png=png_of(figure), caption=caption)


def _limits(axis: Axes, limit: float, label: str) -> None:
    """Dashed lines at plus and minus the limit."""
    for sign in (1, -1):
        axis.axhline(sign * limit, color="tab:red", linestyle="--", linewidth=1, label=label if sign > 0 else None)


def _averages(laser: LaserCalibration) -> list[tuple[np.ndarray, np.ndarray]]:
    """By view: positions along the stripe and mean residuals there."""
    along = 0 if abs(laser.normal[1]) >= abs(laser.normal[0]) else 1
    averages = []
    for view in laser.views:
        position = view.points[:, along] / view.points[:, 2]
        bins = np.round(position / _BIN_SHARE).astype(int)
        every, count = np.unique(bins, return_counts=True)
        kept = every[count >= _MIN_COUNT]
        mean = np.array([view.residual_m[bins == each].mean() for each in kept])
        averages.append((kept * _BIN_SHARE, mean))
    return averages


def _depths(calibration: PlanesCalibration) -> Picture:
    seen = [view.distance_m for laser in calibration.lasers for view in laser.views]
    distances_m = np.linspace(0.5 * min(seen), 2 * max(seen), _DEPTHS).tolist()
    depth_sd_m = worst_depth_sd_m(calibrated_rig(calibration), distances_m)
    figure = canvas(10, 4)
    axis = figure.subplots()
    for laser, worst in zip(calibration.lasers, depth_sd_m, strict=True):
        axis.plot(distances_m, 1e3 * worst, label=drawn(laser.name))
    axis.plot(
        distances_m,
        1e3 * PLANES_LIMITS["depth_sd_m"].good * np.array(distances_m),
        "--",
        color="tab:red",
        label="good limit",
    )
    axis.axvspan(min(seen), max(seen), color="tab:green", alpha=0.1, label="boards")
    axis.set_xlabel("distance (m)")
    axis.set_ylabel("standard deviation of depth (mm)")
    axis.legend()
    axis.set_ylim(bottom=0)
    caption = "Depth uncertainty by the covariance of camera and planes, at the worst position along each stripe."
    return Picture(png=png_of(figure), caption=caption)
