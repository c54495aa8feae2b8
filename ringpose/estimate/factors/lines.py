"""Lines of the stripes on the ring's face, measured by the ordinates at their two ends."""

from dataclasses import dataclass
from math import sqrt
from typing import NamedTuple

import numpy as np

from ringpose.estimate.linearization import MIN_SIGMA_PX, Derivatives, ImageFactor
from ringpose.geometry.rays import rays_wrt_pixel_and_camera, undistorted_rays
from ringpose.geometry.ring import RingPrediction
from ringpose.types.arrays import Array, Bool, Float64, Int64
from ringpose.types.detection import BreakPoints
from ringpose.types.rig import Camera


@dataclass(frozen=True, kw_only=True, eq=False)
class LineFactor(ImageFactor):
    """The lines of the stripes on the face, by the ordinates y at their two ends."""

    y: Float64[Array, "row"]

    def residuals(self, at: RingPrediction) -> tuple[Float64[Array, "row"], Derivatives]:
        """Eq. (5.4): the heights y - y(x) above the predicted line y(x), Eq. (5.1)."""
        return self.y - at.stripes.rays[self.ray, 1], Derivatives(ordinate=np.full((1, 1), -1.0))

    def wrt_ray(self, at: RingPrediction) -> Float64[Array, "row xy=2"]:
        """The predicted line is taken at the measured abscissa."""
        return np.stack([-at.stripes.slope[self.ray], np.ones(len(self.y))], axis=1)


class Lines(NamedTuple):
    """Lines of the stripes on the ring's face, given by the ordinates at their two ends."""

    laser: Int64[Array, "line"]
    x: Float64[Array, "line end=2"]
    y: Float64[Array, "line end=2"]
    whitening: Float64[Array, "line 2 end=2"]
    """W with W^T W the inverse covariance of the two ordinates."""
    wrt_camera: Float64[Array, "line end=2 xy=2 parameter"]
    """Derivatives of x and y for fixed pixels by the camera's parameters, as in `CAMERA_PARAMETERS`."""
    stamp_s: Float64[Array, "line"]
    """Mid exposure of the stripe's frame; NaN if unknown."""
    opposite: Bool[Array, "line"]
    """Whether the piece lies on the opposite arc."""

    @property
    def pieces(self) -> Int64[Array, "line"]:
        """A number for each piece of a stripe on an arc, the same where it was measured again."""
        numbers: Int64[Array, "line"] = 2 * self.laser + self.opposite
        return numbers

    @property
    def numbers(self) -> int:
        """Number of measured values; the line of a piece that was measured twice counts once."""
        return 2 * len(set(self.pieces.tolist()))

    def factor(self) -> LineFactor:
        """Their factor; the rays of their ends come first."""
        whitening = np.zeros((2 * len(self.laser), 2 * len(self.laser)))
        for number, block in enumerate(self.whitening):
            whitening[2 * number : 2 * number + 2, 2 * number : 2 * number + 2] = block
        return LineFactor(
            stamp_s=np.repeat(self.stamp_s, 2),
            opposite=np.repeat(self.opposite, 2),
            ray=slice(0, len(whitening)),
            whitening=whitening,
            y=self.y.ravel(),
        )


def lines_of(break_points: BreakPoints, camera: Camera, *, opposite: bool = False) -> Lines:
    """The lines of the stripes on the face that are known."""
    stamp_s = stamps_of(break_points)
    line_px = np.stack([break_points.face_start_undistorted_px, break_points.face_end_undistorted_px], axis=1)
    has_line = np.isfinite(line_px.sum(axis=(1, 2)) + break_points.face_sigma_px.sum(axis=1))
    line_xy = undistorted_rays(line_px[has_line], camera)[..., :2]
    _, wrt_camera = rays_wrt_pixel_and_camera(line_xy.reshape(-1, 2), camera)
    sigma = np.maximum(break_points.face_sigma_px[has_line], MIN_SIGMA_PX) / camera.camera_matrix[1, 1]
    whitening = np.zeros((len(line_xy), 2, 2))
    for block, sds in zip(whitening, sigma.tolist(), strict=True):
        block[0, 0], block[1, 0], block[1, 1] = line_whitening(*sds)
    return Lines(
        laser=np.flatnonzero(has_line),
        x=line_xy[..., 0],
        y=line_xy[..., 1],
        whitening=whitening,
        wrt_camera=wrt_camera.reshape(*line_xy.shape, wrt_camera.shape[-1]),
        stamp_s=stamp_s[has_line],
        opposite=np.full(len(line_xy), opposite),
    )


def stamps_of(break_points: BreakPoints) -> Float64[Array, "laser"]:
    """Mid exposure of the frame of each laser; NaN where it is unknown."""
    return np.full(len(break_points.flags), np.nan) if break_points.stamp_s is None else break_points.stamp_s


def line_whitening(start_sd: float, end_sd: float) -> tuple[float, float, float]:
    """Inverse Cholesky factor (11, 21, 22) of the joint covariance of a fitted line's ordinates at its two ends.

    An ordinate at the share t of the line's length has the variance s^2 (1 + 12 (t - a)^2), for centres spread
    evenly over the length; a, where this variance is smallest, follows from the two given ones (1/2 if they are
    equal), and the covariance of the two ends is s^2 (1 - 12 a (1 - a)). If the ratio of the two exceeds sqrt(13),
    a is set to the end with the smaller one.
    """
    start, end = start_sd * start_sd, end_sd * end_sd
    # (end - start) 12 a^2 + 24 start a + end - 13 start = 0; the root that stays finite for equal sigmas
    quadratic, linear, constant = 12.0 * (end - start), 24.0 * start, end - 13.0 * start
    a = -2.0 * constant / (linear + sqrt(max(linear * linear - 4.0 * quadratic * constant, 0.0)))
    a = min(max(a, 0.0), 1.0)
    covariance = 1.0 - 12.0 * a * (1.0 - a)
    correlation = covariance / sqrt((1.0 + 12.0 * a * a) * (1.0 + 12.0 * (1.0 - a) ** 2))
    sine = sqrt(1.0 - correlation * correlation)
    return 1.0 / start_sd, -correlation / (start_sd * sine), 1.0 / (end_sd * sine)
