"""Whitening matrices of noise covariances, and care for sigmas too small for float64."""

from __future__ import annotations

import logging
from functools import cache

import numpy as np

from relnav_graph.arrays import Array
from relnav_graph.core.contracts import Sensor
from relnav_graph.core.measurement import Measurement
from relnav_graph.errors import InputError, ModelError

__all__ = ["inverse_cholesky", "measurement_noise", "raised", "with_constraints"]

_LOG = logging.getLogger(__name__)

#: A sigma below this fraction of the measured value is lost in the value's rounding.
RESOLUTION = 1e2 * float(np.finfo(np.float64).eps)
#: Sigma of process noise, SI, that stands for none: smaller than any state here resolves, yet
#: not so small that rows whitened with its inverse drown the others in rounding errors.
SMALLEST = 1e-12


def raised(where: str, noise: Array, z: Array) -> Array:
    """Noise R with sigmas below the resolution of the values raised to it, and a warning.

    noise: (k, rows, rows); z: values (k, nz). Returns (k, rows, rows).
    """
    floor = (RESOLUTION * np.abs(z).max(axis=1, initial=0.0)) ** 2
    variances = np.einsum("kii->ki", noise)
    low = (variances > 0) & (variances < floor[:, None])
    if low.any():
        smallest, floors = np.sqrt(variances[low].min()), np.sqrt(floor.max())
        _warn(
            f"{where}: sigma {smallest:.3g} is lost in the rounding of values of"
            f" {np.abs(z).max():.2g}; raised to {floors:.2g}"
        )
        noise = noise.copy()
        k, i = np.nonzero(low)
        noise[k, i, i] = floor[k]
    return noise


@cache
def _warn(text: str) -> None:
    """Log a warning once, not for every epoch."""
    _LOG.warning(text)


def measurement_noise(name: str, sensor: Sensor, m: Measurement) -> Array:
    """Noise covariances R (k, rows, rows) of the k observations of a measurement.

    Raises ModelError when the sensor gives another shape, InputError when R is not symmetric.
    """
    noise = np.asarray(sensor.noise(m) if m.covariance is None else m.covariance)
    expected = (len(m.z), sensor.rows, sensor.rows)
    if noise.shape != expected:
        raise ModelError(
            f"sensor {name!r} at t = {m.t} s: noise gives {noise.shape}, expected {expected}"
        )
    skew = np.abs(noise - noise.transpose(0, 2, 1)).max(initial=0.0)
    if skew > 1e-9 * np.abs(noise).max(initial=0.0):
        raise InputError(f"sensor {name!r} at t = {m.t} s: the noise covariance is not symmetric")
    return noise


def with_constraints(Q: Array) -> Array:
    """Process noise in which a state without any gets the sigma `SMALLEST`, and a warning.

    Q: (M, n, n). Returns (M, n, n). So small a sigma acts as a constraint.
    """
    _warn(f"process noise: a state without any is held by a sigma of {SMALLEST:g}")
    diagonal = np.einsum("kii->ki", Q)
    return Q + np.where(diagonal == 0.0, SMALLEST**2, 0.0)[:, :, None] * np.eye(Q.shape[1])


def inverse_cholesky(where: str, covariances: Array) -> Array:
    """Whitening matrices ``W = L^-1``, ``L L^T`` the covariance: ``W^T W`` is its inverse.

    covariances: (..., n, n). Returns (..., n, n), lower triangular. Raises InputError unless
    every covariance is positive definite.
    """
    scale = np.sqrt(np.einsum("...ii->...i", covariances))
    with np.errstate(invalid="ignore", divide="ignore"):
        scaled = covariances / (scale[..., :, None] * scale[..., None, :])
    try:
        if not np.isfinite(scaled).all():
            raise np.linalg.LinAlgError
        factor = np.linalg.cholesky(scaled)
    except np.linalg.LinAlgError as error:
        variances = np.einsum("...ii->...i", covariances)
        raise InputError(
            f"{where}: the noise covariance is not positive definite (variances"
            f" {variances.min():.3g} to {variances.max():.3g}); expected densities and sigmas > 0"
        ) from error
    return np.ascontiguousarray(np.linalg.inv(factor) / scale[..., None, :])
