"""The unscented Kalman filter of the textbooks, in plain NumPy, on vectors.

The conventions are those of FilterPy's `UnscentedKalmanFilter` with `MerweScaledSigmaPoints`: its
points and weights, process noise added, and points drawn anew from the prediction.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from relnav_graph.arrays import Array


class TextbookUkf:
    """van der Merwe 2004, algorithm 3.1 with additive noise. x (n,), P (n, n)."""

    def __init__(self, x: Array, P: Array, alpha: float, beta: float, kappa: float) -> None:
        self.x, self.P, n = x, P, len(x)
        self.scale = alpha**2 * (n + kappa)
        self.mean = np.full(2 * n + 1, 0.5 / self.scale)
        self.spread = self.mean.copy()
        self.mean[0] = (self.scale - n) / self.scale
        self.spread[0] = self.mean[0] + 1 - alpha**2 + beta

    def _points(self) -> Array:
        columns = np.linalg.cholesky(self.scale * self.P).T
        return np.concatenate([self.x[None], self.x + columns, self.x - columns])

    def predict(self, f: Callable[[Array], Array], Q: Array) -> None:
        """Carry x (n,) and P (n, n) through f, with the noise Q (n, n)."""
        points = np.array([f(x) for x in self._points()])
        self.x = self.mean @ points
        d = points - self.x
        self.P = (self.spread * d.T) @ d + Q

    def update(self, h: Callable[[Array], Array], z: Array, R: Array) -> None:
        """Take in z (m,), h of the state with the noise R (m, m)."""
        points = self._points()
        seen = np.array([h(x) for x in points])
        expected = self.mean @ seen
        e, d = seen - expected, points - self.x
        S = (self.spread * e.T) @ e + R
        K = np.linalg.solve(S, (self.spread * e.T) @ d).T
        self.x, self.P = self.x + K @ (z - expected), self.P - K @ S @ K.T
