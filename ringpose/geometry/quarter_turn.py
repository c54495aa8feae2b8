"""Measurements as of the camera turned by 90 degrees about its axis, for rigs whose stripes run along image columns.

Detector and estimator treat stripes that run along the image rows. Images, camera, light planes and what is known
before are turned, then what was measured is turned back (ringpose-method(7), section 3). In a proper rotation about the
optical axis, the tilt basis turns with its normal, so that tilts, distances and their covariances keep their values.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import cv2
import numpy as np

from ringpose.geometry.camera_motion import CameraMotion
from ringpose.geometry.ring import RingArcs
from ringpose.geometry.rotations import tilt_basis
from ringpose.types.arrays import Array, Float64
from ringpose.types.detection import (
    BreakPoints,
    Detection,
    JudgedRing,
    RingEdgePoints,
    Segments,
    Stripes,
    SubtractedGhost,
)
from ringpose.types.image import Frame, Shot
from ringpose.types.pose import (
    MEASURED_PARAMETERS,
    PlaneEvidence,
    PoseResult,
    RingMeasurement,
    RingPose,
    RingVelocity,
)
from ringpose.types.protection import turned
from ringpose.types.rig import Camera, Mount, ParameterCovariance, Rig

_AXES = ("fx", "fy"), ("cx", "cy"), ("p2", "p1")
"""Parameters of a camera that belong to its x and y axis: p2 and p1 are the components of a vector t, by which a lens
displaces x by r^2 t + 2 (t . x) x."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class QuarterTurn:
    """A rotation about the optical axis by 90 degrees: positions are turned by a matrix and shifted into the image."""

    matrix: Float64[Array, "2 2"]
    offset_px: Float64[Array, "2"]
    rotation: int
    """OpenCV's code of the rotation of an image."""

    @property
    def rotation_3d(self) -> Float64[Array, "3 3"]:
        """Rotation of vectors in the camera frame."""
        rotation = np.eye(3)
        rotation[:2, :2] = self.matrix
        return rotation

    def image(self, image: Array) -> Array:
        """A turned image."""
        return np.asarray(cv2.rotate(image, self.rotation))

    def points(self, position_px: Float64[Array, "*shape xy=2"]) -> Float64[Array, "*shape xy=2"]:
        """Turned positions; of distorted and of undistorted pixels alike."""
        turned: Float64[Array, "*shape xy=2"] = position_px @ self.matrix.T + self.offset_px
        return turned

    def vectors(self, vector: Float64[Array, "*shape xyz=3"]) -> Float64[Array, "*shape xyz=3"]:
        """Turned vectors of the camera frame."""
        turned: Float64[Array, "*shape xyz=3"] = vector @ self.rotation_3d.T
        return turned

    # What is given

    def camera(self, camera: Camera) -> Camera:
        """The turned camera."""
        matrix, coefficients = camera.camera_matrix.copy(), camera.distortion_coefficients.copy()
        matrix[[0, 1], [0, 1]] = matrix[[1, 0], [1, 0]]
        matrix[:2, 2] = self.points(camera.camera_matrix[:2, 2])
        coefficients[[3, 2]] = self.matrix @ coefficients[[3, 2]]
        return replace(
            camera,
            image_width=camera.image_height,
            image_height=camera.image_width,
            camera_matrix=matrix,
            distortion_coefficients=coefficients,
            covariance=None if camera.covariance is None else self._covariance(camera.covariance),
        )

    def rig(self, rig: Rig) -> Rig:
        """The turned rig."""
        lasers, mount = rig.lasers, rig.mount
        return replace(
            rig,
            camera=self.camera(rig.camera),
            lasers=replace(lasers, normal=self.vectors(lasers.normal), projector_m=self.vectors(lasers.projector_m)),
            covariance=None if rig.covariance is None else self._covariance(rig.covariance),
            mount=None if mount is None else self._mount(mount),
            ghosts={name: replace(ghost, offset_px=-ghost.offset_px) for name, ghost in rig.ghosts.items()},
        )

    def ghosts(self, ghosts: Sequence[SubtractedGhost]) -> tuple[SubtractedGhost, ...]:
        """Turned ghosts: by each of the two quarter turns, a column further on becomes a row further back."""
        return tuple(replace(ghost, offset_px=-ghost.offset_px) for ghost in ghosts)

    def motion(self, camera: CameraMotion | None) -> CameraMotion | None:
        """The motion of the turned camera."""
        return None if camera is None else replace(camera, mount=self._mount(camera.mount))

    def shot(self, shot: Shot) -> Shot:
        """The shot with turned images."""
        return replace(shot, images=np.stack([self.image(image) for image in shot.images]))

    def frame(self, frame: Frame | None) -> Frame | None:
        """The turned frame."""
        return None if frame is None else replace(frame, image=self.image(frame.image))

    def arcs(self, arcs: RingArcs) -> RingArcs:
        """The turned ring; covariances of its steps, which refer to its own axes, hold as they are."""
        return replace(arcs, origin=self.vectors(arcs.origin), axes=self.vectors(arcs.axes))

    def _mount(self, mount: Mount) -> Mount:
        turned = mount.carrier_from_camera.copy()
        turned[:3, :3] = turned[:3, :3] @ self.rotation_3d.T
        return replace(mount, carrier_from_camera=turned)

    # What is measured

    def detection(self, detection: Detection) -> Detection:
        """The turned detection."""
        points, stripes, segments, edges, ring = (
            detection.break_points, detection.stripes, detection.segments, detection.ring_edges, detection.ring
        )  # fmt: skip
        return replace(
            detection,
            break_points=self.break_points(points) if isinstance(points, BreakPoints) else points,
            ring_edges=None if edges is None else self.edges(edges),
            ring=None if ring is None else self.judged(ring),
            stripes=None if stripes is None else self.stripes(stripes),
            segments=None if segments is None else self._segments(segments),
            ghosts=self.ghosts(detection.ghosts),
        )

    def break_points(self, points: BreakPoints) -> BreakPoints:
        """Turned break points."""
        return replace(
            points,
            position_px=self.points(points.position_px),
            covariance_px2=self.matrix @ points.covariance_px2 @ self.matrix.T,
            face_start_undistorted_px=self.points(points.face_start_undistorted_px),
            face_end_undistorted_px=self.points(points.face_end_undistorted_px),
            repeated=None if points.repeated is None else self.break_points(points.repeated),
            opposite=None if points.opposite is None else self.break_points(points.opposite),
        )

    def edges(self, edges: RingEdgePoints) -> RingEdgePoints:
        """Turned points of the ring's edges."""
        return replace(edges, position_px=self.points(edges.position_px), normal=edges.normal @ self.matrix.T)

    def judged(self, ring: JudgedRing) -> JudgedRing:
        """The turned ring that a detection was judged by."""
        return replace(
            ring,
            origin_m=self.vectors(ring.origin_m),
            axes=self.vectors(ring.axes),
            velocity_m_s=self.vectors(ring.velocity_m_s),
            rate_rad_s=self.vectors(ring.rate_rad_s),
        )

    def stripes(self, stripes: Stripes) -> Stripes:
        """Turned stripe centres."""
        return replace(stripes, position_px=self.points(stripes.position_px))

    def _segments(self, segments: Segments) -> Segments:
        return replace(segments, start_px=self.points(segments.start_px), end_px=self.points(segments.end_px))

    # What is estimated

    def result(self, result: PoseResult) -> PoseResult:
        """The turned result of the estimation."""
        pose, velocity, measurement, evidence = result.pose, result.velocity, result.measurement, result.plane_evidence
        normal = pose.normal if isinstance(pose, RingPose) else np.full(3, np.nan)
        return replace(
            result,
            pose=self._pose(pose) if isinstance(pose, RingPose) else pose,
            velocity=None if velocity is None else self._velocity(velocity, normal),
            measurement=None if measurement is None else self._measurement(measurement),
            plane_evidence=None if evidence is None else self._evidence(evidence),
            separation=None if result.separation is None else turned(result.separation, self.rotation_3d),
        )

    def _pose(self, pose: RingPose) -> RingPose:
        covariance, center, grasp = pose.covariance, pose.covariance_center_m2, pose.covariance_grasp_m2
        basis = np.eye(7)
        basis[:2, :2] = basis[3:5, 3:5] = self._basis(pose.normal)
        return replace(
            pose,
            center_m=self.vectors(pose.center_m),
            normal=self.vectors(pose.normal),
            grasp_m=self.vectors(pose.grasp_m),
            covariance=None if covariance is None else _changed(covariance, basis),
            covariance_center_m2=None if center is None else _changed(center, self.rotation_3d),
            covariance_grasp_m2=None if grasp is None else _changed(grasp, self.rotation_3d),
        )

    def _velocity(self, velocity: RingVelocity, normal: Float64[Array, "xyz=3"]) -> RingVelocity:
        change = np.zeros((5, 5))
        change[:3, :3], change[3:, 3:] = self.rotation_3d, self._basis(normal)
        return replace(
            velocity,
            center_m_s=self.vectors(velocity.center_m_s),
            rate_rad_s=self.vectors(velocity.rate_rad_s),
            covariance=_changed(velocity.covariance, change),
        )

    def _measurement(self, measurement: RingMeasurement) -> RingMeasurement:
        """The rows in the turned parameters x' = C x: R x = R C^T x', made upper-trapezoidal again."""
        at, ring = measurement.linearized_at, len(MEASURED_PARAMETERS)
        basis = self._basis(at.normal)
        change = np.eye(ring)
        change[:2, :2] = change[3:5, 3:5] = change[10:, 10:] = basis
        change[7:10, 7:10] = self.rotation_3d
        names, signs = self._parameters(measurement.nuisance_parameters)
        rows = measurement.square_root.copy()
        rows[:, :ring] = rows[:, :ring] @ change.T
        rows[:, ring:-1] *= signs
        upper: Array = np.linalg.qr(rows, mode="r")  # type: ignore[assignment]  # typed as for another mode
        turned = replace(
            at,
            center_m=self.vectors(at.center_m),
            normal=self.vectors(at.normal),
            velocity_m_s=self.vectors(at.velocity_m_s),
            rate_rad_s=self.vectors(at.rate_rad_s),
        )
        return replace(
            measurement,
            linearized_at=turned,
            nuisance_parameters=names,
            square_root=upper,
        )

    def _evidence(self, evidence: PlaneEvidence) -> PlaneEvidence:
        names, signs = self._parameters(evidence.parameters)
        return replace(
            evidence,
            parameters=names,
            rows=evidence.rows * np.append(signs, 1.0),
            normal=self.vectors(evidence.normal),
            place_m=self.vectors(evidence.place_m),
        )

    # Parameters

    def _basis(self, normal: Float64[Array, "xyz=3"]) -> Float64[Array, "2 2"]:
        """The change of components in the tilt basis of a normal: 1 but for a normal along the optical axis."""
        if not np.isfinite(normal).all():
            return np.eye(2)
        change: Float64[Array, "2 2"] = tilt_basis(self.vectors(normal)) @ self.rotation_3d @ tilt_basis(normal).T
        return change

    def _parameters(self, names: Sequence[str]) -> tuple[tuple[str, ...], Float64[Array, "parameter"]]:
        """The names of turned parameters, and the signs of their increments."""
        renamed: dict[str, tuple[str, float]] = {}
        for pair in _AXES:
            for old, name in enumerate(pair):
                new = int(np.abs(self.matrix[:, old]).argmax())
                renamed[name] = pair[new], 1.0 if pair[0] == "fx" else float(self.matrix[new, old])
        turned = [renamed.get(name, (name, 1.0)) for name in names]
        return tuple(name for name, _ in turned), np.array([sign for _, sign in turned])

    def _covariance(self, covariance: ParameterCovariance) -> ParameterCovariance:
        names, signs = self._parameters(covariance.parameters)
        return ParameterCovariance(parameters=names, data=covariance.data * signs[:, None] * signs)


def _changed(covariance: Float64[Array, "n n"], change: Float64[Array, "n n"]) -> Float64[Array, "n n"]:
    """A covariance in changed components; rows and columns of what is not determined are NaN in both."""
    changed: Float64[Array, "n n"] = change @ np.nan_to_num(covariance) @ change.T
    unknown = np.abs(change) @ np.isnan(np.diag(covariance)) > 0.5
    changed[unknown], changed[:, unknown] = np.nan, np.nan
    return changed


_QUARTER = np.array([[0.0, 1.0], [-1.0, 0.0]])


def to_rows(camera: Camera) -> QuarterTurn:
    """The turn after which columns of the camera's image are rows: (x, y) becomes (y, width - 1 - x)."""
    offset_px = np.array([0.0, camera.image_width - 1.0])
    return QuarterTurn(matrix=_QUARTER, offset_px=offset_px, rotation=cv2.ROTATE_90_COUNTERCLOCKWISE)


def to_columns(camera: Camera) -> QuarterTurn:
    """The turn back, for the camera as it is given: (x, y) becomes (width - 1 - y, x)."""
    offset_px = np.array([camera.image_width - 1.0, 0.0])
    return QuarterTurn(matrix=_QUARTER.T, offset_px=offset_px, rotation=cv2.ROTATE_90_CLOCKWISE)


@lru_cache(maxsize=8)
def rig_along_rows(rig: Rig) -> Rig:
    """The turned rig; the same one for the same rig, as others are derived from it."""
    return to_rows(rig.camera).rig(rig)
