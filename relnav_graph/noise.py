"""Noise covariances: whitening them, and what to do with those that numbers cannot resolve."""

from __future__ import annotations

import logging

import numpy as np
from numpy.typing import NDArray

from relnav_graph.errors import InputError, ModelError
from relnav_graph.models import Measurement, Sensor

__all__ = ["inverse_cholesky", "measurement_noise", "raised", "with_constraints"]

_LOG = logging.getLogger(__name__)
Array = NDArray[np.float64]

#: A sigma below this fraction of the number that it belongs to is lost in rounding.
RESOLUTION = 1e2 * float(np.finfo(np.float64).eps)
#: The smallest sigma of process noise, in SI: what no state here resolves.
SMALLEST = 1e-14


def raised(where: str, noise: Array, z: Array) -> Array:
    """Noise R (k, rows, rows) of values z (k, nz), with sigmas below what the values can
    resolve raised to that; which is said."""
    floor = (RESOLUTION * np.abs(z).max(axis=1, initial=0.0)) ** 2
    variances = np.einsum("kii->ki", noise)
    low = (variances > 0) & (variances < floor[:, None])
    if low.any():
        _LOG.warning(
            "%s: sigma %.3g is lost in the rounding of values of %.3g; raised to %.3g",
            *(where, np.sqrt(variances[low].min()), np.abs(z).max(), np.sqrt(floor.max())),
        )
        noise = noise.copy()
        k, i = np.nonzero(low)
        noise[k, i, i] = floor[k]
    return noise


def measurement_noise(name: str, sensor: Sensor, m: Measurement) -> Array:
    """R (k, rows, rows) of a measurement, of the right shape. Raises ModelError, or
    InputError when it is not symmetric."""
    noise = np.asarray(sensor.noise(m))
    expected = (len(m.z), sensor.rows, sensor.rows)
    if noise.shape != expected:
        raise ModelError(
            f"sensor {name!r} at t = {m.t} s: noise gives {noise.shape}, expected {expected}"
        )
    skew = np.abs(noise - noise.transpose(0, 2, 1)).max(initial=0.0)
    if skew > 1e-9 * np.abs(noise).max(initial=0.0):
        raise InputError(f"sensor {name!r} at t = {m.t} s: the noise covariance is not symmetric")
    return noise


def with_constraints(where: str, Q: Array, own: NDArray[np.int64]) -> Array:
    """Process noise Q (M, n, n) in which a state of `own` that has none gets `SMALLEST`: as
    good as a constraint; which is said."""
    variances = Q[:, own, own]
    low = variances < SMALLEST**2
    if not low.any() or not np.isfinite(variances).all():
        return Q
    _LOG.warning("%s: noise of sigma below %.3g is taken as a constraint", where, SMALLEST)
    Q = Q.copy()
    k, i = np.nonzero(low)
    Q[k, own[i], own[i]] = SMALLEST**2
    return Q


def inverse_cholesky(where: str, covariances: Array) -> Array:
    """Whitening matrices (..., n, n) of covariances. Raises InputError unless positive
    definite."""
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
