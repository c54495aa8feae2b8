"""Pictures of a calibration's views: each image with what was found in it, and camera, boards and planes in space."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import MaxNLocator
from mpl_toolkits.mplot3d.art3d import Poly3DCollection
from mpl_toolkits.mplot3d.proj3d import proj_transform

from ringpose.geometry.rays import rays
from ringpose.geometry.rotations import tilt_basis
from ringpose.report.figures import canvas, drawn, png_of
from ringpose.report.page import Picture
from ringpose.types.arrays import Array, Bool, Float64, UInt8
from ringpose.types.board import BoardPose, BoardView
from ringpose.types.calibration import LaserCalibration
from ringpose.types.rig import Camera

MAX_VIEWS = 24
"""Number of views that are drawn, those with the largest residuals: twice as many make a page of 5 MB."""

_COLUMNS = 3

ARROW_SHARE = 0.03
"""Length of the arrow of an rms residual, in image widths."""

_LIGHT_PERCENTILE = 98
"""Percentile of an image's grey values that is drawn white: most of a dark image with a stripe is far below it."""

_USED, _LEFT_OUT = "#1f77b4", "#d62728"


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class DrawnView:
    """One view of a board as a report shows it."""

    board: BoardView
    pose: BoardPose
    residual_px: Float64[Array, "corner xy=2"]
    """Measured minus projected corners."""
    left_out: Bool[Array, "corner"]
    stripes_px: Sequence[Float64[Array, "_ xy=2"]] = ()
    """Stripe centres by laser."""
    remark: str = ""
    """Why the view is not used."""


def views_picture(
    views: Sequence[DrawnView], camera: Camera, thumbnails: Mapping[str, UInt8[Array, "row column"] | None]
) -> Picture:
    """Each view's image with corners, their residuals as arrows, numbers of some, and stripes."""
    worst = sorted(range(len(views)), key=lambda index: -views[index].pose.residual_rms_px)[:MAX_VIEWS]
    shown = [views[index] for index in sorted(worst)]
    width, height = camera.image_width, camera.image_height
    rows = -(-len(shown) // _COLUMNS)
    figure = canvas(10, rows * (10 / _COLUMNS * height / width + 0.3))
    usual_px = float(np.median([view.pose.residual_rms_px for view in views]))
    factor = ARROW_SHARE * width / max(usual_px, 1e-6)
    axes = figure.subplots(rows, _COLUMNS, squeeze=False).ravel()
    for axis in axes:
        axis.set_axis_off()
    for axis, view in zip(axes, shown, strict=False):
        _draw_view(axis, view, camera, thumbnails.get(view.board.name), factor)
    of = f" The {len(shown)} of {len(views)} views with the largest residuals." if len(shown) < len(views) else ""
    caption = (
        f"Corners with their numbers and residuals, {factor:.0f} times enlarged; red ones are left out. "
        f"Above each view: rms in pixels.{of}"
    )
    return Picture(png=png_of(figure), caption=caption)


def _draw_view(
    axis: Axes, view: DrawnView, camera: Camera, image: UInt8[Array, "row column"] | None, factor: float
) -> None:
    left, right, bottom, top = -0.5, camera.image_width - 0.5, camera.image_height - 0.5, -0.5
    if image is not None:
        white = max(float(np.percentile(image, _LIGHT_PERCENTILE)), 1.0)
        axis.imshow(image, cmap="gray", extent=(left, right, bottom, top), vmin=0, vmax=white)
    for laser, points_px in enumerate(view.stripes_px):
        axis.plot(*points_px.T, ".", markersize=1, color=f"C{laser + 1}")
    colors = np.where(view.left_out, _LEFT_OUT, _USED)
    x, y = view.board.points_px.T
    axis.scatter(x, y, s=4, c=colors, linewidths=0)
    axis.quiver(
        x, y, *(factor * view.residual_px.T), color=colors, angles="xy", scale_units="xy", scale=1.0, width=0.004
    )
    first, last, worst = 0, len(view.board.ids) - 1, int(np.argmax(np.linalg.norm(view.residual_px, axis=1)))
    for index in {first, last, worst, *np.flatnonzero(view.left_out).tolist()}:
        axis.annotate(
            str(view.board.ids[index]), view.board.points_px[index], xytext=(2, 2), textcoords="offset points",
            fontsize=7, color="#ffd000",
        )  # fmt: skip
    axis.set_xlim(left, right)
    axis.set_ylim(bottom, top)
    axis.set_aspect("equal")
    title = f"{drawn(view.board.name)}: {view.pose.residual_rms_px:.3f}" + ", not used" * bool(view.remark)
    axis.set_title(title, fontsize=8, color=_LEFT_OUT if view.remark else "black")


def space_picture(views: Sequence[DrawnView], camera: Camera, lasers: Sequence[LaserCalibration] = ()) -> Picture:
    """Camera, boards and the seen part of each light plane in space, from behind, above and right of the camera."""
    figure = canvas(8, 5.5)
    axes: Any = figure.add_subplot(projection="3d")
    for view in views:
        axes.plot(*_in_view(_outline(view)[[0, 1, 2, 3, 0]]), color=_LEFT_OUT if view.remark else _USED, linewidth=1)
    for index, laser in enumerate(lasers):
        points = np.concatenate([view.points for view in laser.views])
        patch, color = _in_view(_hull(points, laser.normal)).T, f"C{index + 1}"
        axes.add_collection3d(Poly3DCollection([patch], facecolors=color, alpha=0.25))
        axes.plot(*np.vstack([patch, patch[:1]]).T, color=color, linewidth=1.2, label=drawn(laser.name))
    size_m = 0.3 * float(np.median([view.pose.translation_m[2] for view in views]))
    right, low = camera.image_width - 1.0, camera.image_height - 1.0
    rim = size_m * rays(np.array([[0.0, 0.0], [right, 0.0], [right, low], [0.0, low]]), camera)
    for corner, following in zip(rim, np.roll(rim, -1, axis=0), strict=True):
        axes.plot(*_in_view(np.stack([np.zeros(3), corner, following])), color="black", linewidth=0.8)
    for name, direction, color in zip("xyz", np.eye(3), ("tab:red", "tab:green", "tab:blue"), strict=True):
        axes.plot(*_in_view(np.stack([np.zeros(3), 0.5 * size_m * direction])), color=color, linewidth=2)
        axes.text(*_in_view(0.55 * size_m * direction), name, color=color)
    axes.set_aspect("equal")
    for axis in (axes.xaxis, axes.yaxis, axes.zaxis):
        axis.set_major_locator(MaxNLocator(4))
    axes.set_xlabel("z (m)")
    axes.set_ylabel("-x (m)")
    axes.set_zlabel("-y (m)")
    axes.view_init(elev=25, azim=-140)
    if lasers:
        axes.legend(loc="upper left")
    _name_boards(axes, views)
    caption = "The camera and its axes, the boards" + (
        ", and each light plane as far as they show it." if lasers else "."
    )
    return Picture(png=png_of(figure), caption=caption)


def _name_boards(axes: Any, views: Sequence[DrawnView]) -> None:
    """Names of the boards in a column beside the drawing, in the order of their heights, each with a line to its board.

    At the boards themselves they would cover each other: good views overlap.
    """
    first_corners = np.stack([_in_view(_outline(view)[0]) for view in views], axis=1)
    across, up, _ = proj_transform(*first_corners, axes.get_proj())
    order = np.argsort(up)
    rows = np.linspace(0.05, 0.95, len(views)) if len(views) > 1 else np.array([0.5])
    for row, index in zip(rows, order.tolist(), strict=True):
        axes.annotate(
            drawn(views[index].board.name), (across[index], up[index]), xytext=(1.0, row), textcoords="axes fraction",
            fontsize=min(7, 280 / len(views)), va="center",
            arrowprops={"arrowstyle": "-", "color": "0.6", "linewidth": 0.4, "shrinkB": 0},
        )  # fmt: skip


def _outline(view: DrawnView) -> Float64[Array, "corner=4 xyz=3"]:
    """The rectangle around a board's corners, in the camera frame."""
    outline = _rectangle(view.board.points_board_m) @ view.pose.rotation.T + view.pose.translation_m
    return np.asarray(outline, dtype=np.float64)


def _in_view(points: Float64[Array, "*n xyz=3"]) -> Float64[Array, "3 *n"]:
    """Coordinates along the axes of the drawing: forward, to the left, and up."""
    return np.array([points[..., 2], -points[..., 0], -points[..., 1]])


def _rectangle(points_m: Float64[Array, "n xyz=3"]) -> Float64[Array, "corner=4 xyz=3"]:
    """The rectangle around points of a board."""
    (left, top, _), (right, bottom, _) = points_m.min(axis=0), points_m.max(axis=0)
    return np.array([[left, top, 0.0], [right, top, 0.0], [right, bottom, 0.0], [left, bottom, 0.0]])


def _hull(points: Float64[Array, "n xyz=3"], normal: Float64[Array, "xyz=3"]) -> Float64[Array, "m xyz=3"]:
    """Those points of a plane whose convex polygon holds all of them, around it."""
    within = (points @ tilt_basis(normal).T).astype(np.float32)
    return points[np.asarray(cv2.convexHull(within, returnPoints=False)).ravel()]
