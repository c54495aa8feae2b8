"""The key `covariance` of camera.yaml and rig.yaml: a joint covariance of named parameters."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from ringpose.files.schema import Fields, hint
from ringpose.types.arrays import Array, Float64
from ringpose.types.rig import ParameterCovariance

_TOLERANCE = 1e-9
"""Rounding errors of the correlation matrix: asymmetry, and negative eigenvalues per row."""


def read_covariance(parent: Fields, known: Sequence[str]) -> ParameterCovariance | None:
    """The covariance under the optional key `covariance` of a camera or rig; its parameters must be known ones."""
    if not parent.has("covariance"):
        return None
    fields = parent.fields("covariance", ("parameters", "data"))
    names = fields.texts("parameters")
    for name in names:
        if name not in known:
            raise fields.problem("parameters", f"unknown parameter {name!r}", hint(name, known))
    if len(set(names)) != len(names):
        raise fields.problem("parameters", "a parameter occurs twice")
    data = checked_covariance(fields, "data", fields.array("data", (len(names), len(names))))
    return ParameterCovariance(parameters=names, data=data)


def covariance_values(covariance: ParameterCovariance) -> dict[str, Any]:
    """The mapping that `read_covariance` reads."""
    return {"parameters": list(covariance.parameters), "data": covariance.data}


def checked_covariance(fields: Fields, key: str, data: Float64[Array, "n n"]) -> Float64[Array, "n n"]:
    """The covariance at a key, made exactly symmetric; rejected unless symmetric and positive semidefinite."""
    variance = np.diag(data)
    if (variance < 0).any():
        raise fields.problem(key, "has a negative variance on its diagonal")
    sigma = np.sqrt(np.where(variance > 0, variance, 1.0))
    correlation = data / np.outer(sigma, sigma)
    if np.abs(correlation - correlation.T).max(initial=0.0) > _TOLERANCE:
        raise fields.problem(key, "is not symmetric")
    if len(data) and np.linalg.eigvalsh(correlation).min() < -_TOLERANCE * len(data):
        raise fields.problem(key, "is not positive semidefinite")
    return (data + data.T) / 2
