"""Errors that all shots have in common, with the priors that the records state (ringpose-method(7), 9, 11, 12)."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import lru_cache
from types import MappingProxyType

import numpy as np

from ringpose.errors import DataError
from ringpose.estimate.nuisance import FORM_PARAMETERS, covariance_root, form_amplitude_m
from ringpose.types.arrays import Array, Float64
from ringpose.types.assumptions import RigStability
from ringpose.types.pose import PoseLine, Priors, RingMeasurement
from ringpose.types.rig import MOUNT_PARAMETERS, Mount, ParameterCovariance, PlaneCorrection, Rig, laser_parameters

NOT_CALIBRATED = ParameterCovariance(parameters=(), data=np.zeros((0, 0)))
"""Covariance of a rig that counts as exact."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CommonErrors:
    """Nuisance parameters of the records, and the square root R of their prior covariance R R^T.

    The columns of R are independent errors of unit variance; each amplitude of the ring's form has one of its own.
    """

    names: tuple[str, ...]
    root: Float64[Array, "parameter error"]
    form_columns: tuple[int, ...] = ()
    """The errors that are amplitudes of the ring's form."""
    of_mount: bool = False
    """Whether the last errors are those of the camera's mount (`CameraState.displacement_root`)."""

    @property
    def with_form(self) -> bool:
        """Whether the amplitudes of the ring's form are among the parameters."""
        return FORM_PARAMETERS[0] in self.names

    @property
    def without_form(self) -> tuple[tuple[str, ...], Float64[Array, "parameter error"]]:
        """The names and the root of the other parameters."""
        rows = [index for index, name in enumerate(self.names) if name not in FORM_PARAMETERS]
        return tuple(self.names[row] for row in rows), np.delete(self.root[rows], self.form_columns, axis=1)

    def with_tolerance(self, ring_tolerance_m: float) -> "CommonErrors":
        """The errors for a ring whose form has another tolerance."""
        of_form = [index for index, name in enumerate(self.names) if name in FORM_PARAMETERS]
        root = self.root.copy()
        root[np.ix_(of_form, self.form_columns)] = form_amplitude_m(ring_tolerance_m) * np.eye(len(of_form))
        return replace(self, root=root)

    def root_of(self, names: tuple[str, ...]) -> Float64[Array, "some error"]:
        """The rows of R of some of the parameters."""
        return self.root if names == self.names else self.root[[self.names.index(name) for name in names]]


def common_errors(
    line: PoseLine,
    measurement: RingMeasurement,
    rig: Rig | None,
    mount: Mount | None = None,
    *,
    with_form: bool = False,
) -> CommonErrors:
    """The nuisance parameters of a record, with the priors that it states: calibration, stability, form of the ring.

    Those of the camera's mount have the errors of `mount`. `with_form`: the amplitudes of the ring's form are added to
    the parameters of a record that has none, as other records of the stream have them. Raises `DataError` if the record
    needs a rig file or a mount that is not given, or names a parameter without a prior.
    """
    priors = line.priors or Priors()
    names = tuple(name for name in measurement.nuisance_parameters if name not in MOUNT_PARAMETERS)
    of_mount = tuple(name for name in measurement.nuisance_parameters if name in MOUNT_PARAMETERS)
    if with_form and FORM_PARAMETERS[0] not in names:
        names += FORM_PARAMETERS
    if not priors.rig_covariance:
        rig = None
    elif rig is None or rig.covariance is None:
        raise DataError(line.shot, "its priors include the covariance of a rig file", "give that file with --rig")
    assumed = priors.assumptions
    bow_sds = tuple((f"{laser}.bow", bow.sd_per_rad) for laser, bow in priors.bent_planes.items())
    added = names, assumed.stability, assumed.ring_tolerance_m, assumed.face_slope_rad, bow_sds, rig
    # planes that have moved are those of the following shots; they change when another plane has moved
    moved = priors.moved_planes
    common = _common_errors(*added, moved) if moved else _common_errors_of_stream(*added)
    if isinstance(common, str):
        remedy = "give the output of ringpose pose unchanged"
        raise DataError(line.shot, f"has the nuisance parameter {common!r}, for which it states no prior", remedy)
    if mount is None and measurement.camera_motion == "robot_poses":
        raise DataError(line.shot, "was measured with robot poses", "give --robot-poses, and --rig with its mount")
    return common if mount is None or not of_mount else _with_mount(common, (*names, *of_mount), mount)


def _with_mount(others: CommonErrors, names: tuple[str, ...], mount: Mount) -> CommonErrors:
    """The errors with those of the mount appended: a column of the root for each independent error, the delay last."""
    of_mount = np.zeros((len(MOUNT_PARAMETERS), len(MOUNT_PARAMETERS)))
    of_mount[:6, :6], of_mount[6, 6] = mount.root, mount.delay_sd_s
    errors = others.root.shape[1]
    root = np.zeros((len(names), errors + len(MOUNT_PARAMETERS)))
    for row, name in enumerate(names):
        if name in MOUNT_PARAMETERS:
            root[row, errors:] = of_mount[MOUNT_PARAMETERS.index(name)]
        else:
            root[row, :errors] = others.root[others.names.index(name)]
    return CommonErrors(names=names, root=root, form_columns=others.form_columns, of_mount=True)


def _common_errors(
    names: tuple[str, ...],
    stability: RigStability,
    ring_tolerance_m: float,
    face_slope_rad: float,
    bow_sds: tuple[tuple[str, float], ...],
    rig: Rig | None,
    moved_planes: Mapping[str, PlaneCorrection] = MappingProxyType({}),
) -> CommonErrors | str:
    """The errors, or the name of a parameter without a prior; the same for all records of a stream."""
    stated, every = dict(bow_sds), names
    names = tuple(name for name in every if name not in FORM_PARAMETERS)
    calibrated = NOT_CALIBRATED if rig is None or rig.covariance is None else rig.covariance
    covariance = calibrated.of(names)
    added = {
        "tilt_1": stability.plane_tilt_rad,
        "tilt_2": stability.plane_tilt_rad,
        "distance": stability.plane_distance_m,
        "focal_ratio": stability.focal_ratio,
        "slope": face_slope_rad,
    }
    for index, name in enumerate(names):
        what = name.rpartition(".")[2]
        if name in stated and name not in calibrated.parameters:
            covariance[index, index] = stated[name] ** 2
            continue
        if what not in added and name not in calibrated.parameters:
            return name
        covariance[index, index] += added.get(what, 0.0) ** 2
    for laser, moved in moved_planes.items():
        of_plane = [names.index(name) for name in laser_parameters([laser]) if name in names]
        covariance[of_plane], covariance[:, of_plane] = 0.0, 0.0
        covariance[np.ix_(of_plane, of_plane)] = moved.covariance
    of_rig = covariance_root(covariance)
    others, form = of_rig.shape[1], len(every) - len(names)
    root = np.zeros((len(every), others + form))
    root[[every.index(name) for name in names], :others] = of_rig
    errors = CommonErrors(names=every, root=root, form_columns=tuple(range(others, others + form)))
    return errors.with_tolerance(ring_tolerance_m)


_common_errors_of_stream = lru_cache(maxsize=8)(_common_errors)
