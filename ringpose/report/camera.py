"""The page that `ringpose calibrate-camera --report` writes: tables, and plots of residuals and uncertainty."""

from collections.abc import Mapping, Sequence
from types import MappingProxyType

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import NullFormatter

from ringpose.calibrate.camera.parameters import parameters_of
from ringpose.calibrate.camera.quality import projection_sigma_m
from ringpose.report.figures import canvas, png_of
from ringpose.report.page import Picture, Section, page, verdict_section
from ringpose.report.views import ARROW_SHARE, DrawnView, space_picture, views_picture
from ringpose.types.arrays import Array, Float64, UInt8
from ringpose.types.calibration import CameraAssessment, CameraCalibration, ModelComparison, Verdict
from ringpose.types.rig import CAMERA_PARAMETERS, Camera
from ringpose.types.table import Table


def camera_report(
    assessment: CameraAssessment,
    verdict: Verdict,
    without_board: Sequence[tuple[str, str]] = (),
    thumbnails: Mapping[str, UInt8[Array, "row column"] | None] = MappingProxyType({}),
) -> str:
    """A self-contained HTML page; `without_board` are the names of images that show no board, and the reasons.

    `thumbnails` are small images of the views, by name.
    """
    calibration, comparison = assessment.calibration, assessment.comparison
    camera = calibration.camera
    deviations = zip(calibration.standard_deviations.items(), parameters_of(camera).tolist(), strict=True)
    parameters = [
        [name + " (px)" * (name in CAMERA_PARAMETERS[:4]), f"{value:.6g}", f"{sd:.2g}" if sd else "held"]
        for (name, sd), value in deviations
    ]
    sigmas_m = zip(assessment.distances_m, projection_sigma_m(assessment), strict=True)
    held_out = {view.name: (f"{view.rms_px:.3f}", f"{view.shift_px:.3f}") for view in assessment.left_out}
    views = [
        [
            view.name,
            str(len(view.left_out)),
            str(int(np.sum(view.left_out))),
            f"{view.pose.residual_rms_px:.3f}",
            *held_out.get(view.name, ("", "")),
            view.rejected,
        ]
        for view in calibration.views
    ]
    views += [[name, "", "", "", "", "", reason] for name, reason in without_board]
    headings = (
        "view", "corners", "left out", "rms (px)", "rms held out (px)", "displacement without it (px)", "why not used"
    )  # fmt: skip
    boards = [
        DrawnView(
            board=view.board, pose=view.pose, residual_px=view.residual_px, left_out=view.left_out, remark=view.rejected
        )
        for view in calibration.views
    ]
    pictures = [space_picture(boards, camera), views_picture(boards, camera, thumbnails)]
    sections = [
        verdict_section(verdict),
        Section(
            title=f"Camera: {camera.image_width} x {camera.image_height} pixels, {camera.distortion_model}",
            text=[
                f"{len(calibration.used)} of {len(calibration.views)} views, rms {calibration.rms_px:.4f} px, "
                f"standard deviation of a corner's coordinate {calibration.sigma_px:.4f} px."
            ],
            table=Table(headings=("parameter", "value", "standard deviation"), rows=parameters),
        ),
        Section(
            title="Projection uncertainty",
            table=Table(
                headings=("distance", "median over the image"),
                rows=[[f"{distance_m:g} m", f"{1e3 * sigma_m:.4f} mm"] for distance_m, sigma_m in sigmas_m],
            ),
            pictures=[uncertainty_map(assessment)],
        ),
        Section(title="Coverage", pictures=[coverage_picture(assessment)]),
        Section(title="Residuals", pictures=[residual_field(calibration)]),
        Section(title="Views", table=Table(headings=headings, rows=views), pictures=pictures),
    ]
    if comparison is not None:
        models = [
            [
                fit.distortion_model,
                str(fit.parameters),
                f"{fit.rms_px:.4f}",
                "unknown" if np.isnan(fit.held_out_rms_px) else f"{fit.held_out_rms_px:.4f}",
            ]
            for fit in comparison.fits
        ]
        table = Table(headings=("model", "parameters", "rms (px)", "rms of views left out (px)"), rows=models)
        pictures = [comparison_picture(calibration, comparison)]
        sections.append(Section(title="Distortion models", table=table, pictures=pictures))
    return page(f"Calibration of {camera.camera_name or 'a camera'}", sections)


WORST_PX = 1.0
"""Limit of a good projection uncertainty, and of the displacement by leaving out one view."""

MIN_SIZE_PX = 1e-3
"""Lower limit of the values in maps: corners are less accurate."""


def residual_field(calibration: CameraCalibration) -> Picture:
    """Residual of each corner as an arrow, red if it was left out, and histograms of the residuals' coordinates."""
    figure = canvas(10, 4.6)
    field, spread = figure.subplots(1, 2, width_ratios=(2.2, 1))
    factor = ARROW_SHARE * calibration.camera.image_width / max(calibration.rms_px, 1e-6)
    for view in calibration.used:
        color = np.where(view.left_out, "#d62728", "#1f77b4")
        x, y = view.points_px.T
        field.quiver(x, y, *(factor * view.residual_px.T), color=color, **_IN_PIXELS)
    _image_axes(field, calibration.camera)
    field.set_title(f"residuals, {factor:.0f} times enlarged")
    errors = np.concatenate([view.residual_px[~view.left_out] for view in calibration.used])
    for axis, name in enumerate("xy"):
        spread.hist(errors[:, axis], bins=41, histtype="step", label=name)
    spread.set_xlabel("residual (px)")
    spread.set_ylabel("corners")
    spread.legend()
    return _picture(
        figure,
        "Measured minus predicted corners. Similar arrows in a part of the image mean that the lens model, the "
        "board or the corners are wrong there; noise has random directions. Red corners were left out.",
    )


def coverage_picture(assessment: CameraAssessment) -> Picture:
    """Corners over the image with the number in each cell, and tilt against distance of the boards."""
    calibration = assessment.calibration
    covered = assessment.coverage
    figure = canvas(10, 4.6)
    image, places = figure.subplots(1, 2, width_ratios=(2.2, 1))
    extent = _extent(calibration.camera)
    most = float(np.log1p(max(covered.corners.max(), 1)))
    image.imshow(np.log1p(covered.corners), extent=extent, cmap="Greens", origin="upper", vmin=0, vmax=1.5 * most)
    for view in calibration.used:
        image.plot(*view.points_px[~view.left_out].T, ".", markersize=1.5, color="0.35", alpha=0.5)
    for (row, column), count in np.ndenumerate(covered.corners):
        rows, columns = covered.corners.shape
        x = (column + 0.5) * calibration.camera.image_width / columns
        y = (row + 0.5) * calibration.camera.image_height / rows
        color = "#c00" if count == 0 else "k"
        image.text(x, y, str(count), ha="center", va="center", color=color, fontsize=10, weight="bold")
    _image_axes(image, calibration.camera)
    image.set_title("corners in each cell")
    places.axvspan(20, 40, color="tab:green", alpha=0.1, label="good tilts")
    places.plot(np.degrees(covered.tilt_rad), covered.distance_m, "o")
    places.legend(loc="lower right")
    places.set_xlabel("tilt of the board (degrees)")
    places.set_ylabel("distance (m)")
    places.set_xlim(left=0)
    places.set_ylim(bottom=0)
    return _picture(
        figure,
        "Grey points are corners, numbers count them, red where there are none. "
        "Good views fill every cell, tilt the board by 20 to 40 degrees to all sides, and differ in distance.",
    )


def uncertainty_map(assessment: CameraAssessment) -> Picture:
    """Maps of the projection's standard deviation, and of its displacement between the two halves of the views."""
    calibration = assessment.calibration
    figure = canvas(10, 4.2)
    left, right = figure.subplots(1, 2)
    _map(figure, left, assessment.sigma_px, calibration.camera)
    left.set_title("projection uncertainty (px, one sigma)")
    if np.isfinite(assessment.split_half_px).all():
        _map(figure, right, assessment.split_half_px, calibration.camera)
    else:
        right.text(0.5, 0.5, "too few views", ha="center", transform=right.transAxes)
    right.set_title("half of the views against the rest (px)")
    return _picture(
        figure,
        "Rms displacement of the projection at each pixel, with the camera frame rotated to minimise it in the middle. "
        "A good camera has less than 1 px everywhere: a red line surrounds larger values. "
        "Where the map is white, no corner determines the lens. "
        "The right picture may be twice the left one: each half has half of the views.",
    )


def comparison_picture(calibration: CameraCalibration, comparison: ModelComparison) -> Picture:
    """Map of the displacement between the cameras of the two distortion models."""
    figure = canvas(6, 4.2)
    axes = figure.subplots()
    _map(figure, axes, comparison.difference_px, calibration.camera)
    axes.set_title("difference of the models (px)")
    return _picture(figure, "The map is white beyond the outermost corners, where the models are not determined.")


_IN_PIXELS = {"angles": "xy", "scale_units": "xy", "scale": 1.0, "width": 0.0015}


def _map(figure: Figure, axes: Axes, values: Float64[Array, "map_row map_column"], camera: Camera) -> None:
    shown = axes.imshow(
        np.maximum(values, MIN_SIZE_PX), extent=_extent(camera), origin="upper", norm="log", interpolation="bilinear"
    )
    values = np.maximum(values, MIN_SIZE_PX)
    levels = np.unique(np.nanquantile(values, (0.25, 0.5, 0.75, 0.9)))
    x = np.linspace(0, camera.image_width - 1, values.shape[1])
    y = np.linspace(0, camera.image_height - 1, values.shape[0])
    if len(levels) > 1:
        axes.clabel(axes.contour(x, y, values, levels=levels, colors="w", linewidths=0.8), fmt="%.2g", fontsize=8)
    if np.nanmin(values) < WORST_PX < np.nanmax(values):
        axes.contour(x, y, values, levels=[WORST_PX], colors="#d62728", linewidths=2)
    bar = figure.colorbar(shown, ax=axes, shrink=0.8, format="{x:g}")
    bar.ax.yaxis.set_minor_formatter(NullFormatter())
    bar.ax.set_ylabel("px")
    _image_axes(axes, camera)


def _extent(camera: Camera) -> tuple[float, float, float, float]:
    return -0.5, camera.image_width - 0.5, camera.image_height - 0.5, -0.5


def _image_axes(axes: Axes, camera: Camera) -> None:
    left, right, bottom, top = _extent(camera)
    axes.set_xlim(left, right)
    axes.set_ylim(bottom, top)
    axes.set_aspect("equal")
    axes.set_xlabel("x (px)")
    axes.set_ylabel("y (px)")


def _picture(figure: Figure, caption: str) -> Picture:
    return Picture(png=png_of(figure), caption=caption)
