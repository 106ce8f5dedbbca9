"""GTSAM's ISAM2 over our factors, as its measured ways ask for: QR, nothing relinearised of itself.

Its default factorisation rejects ordinary ratios of process to state noise. Its own thresholds
cannot decide what to relinearise here (`relnav_graph.estimators.isam2`), and what they would
propagate down the tree at each step is left until the whole is solved. A reference to its
linearisation point is held: without, it copies all its values for each call of each factor.
"""

from __future__ import annotations

import re
import resource
import threading
from dataclasses import dataclass

import gtsam
import numpy as np

from relnav_graph.arrays import Array
from relnav_graph.core.epochs import Epoch
from relnav_graph.errors import EstimationError, RelnavError
from relnav_graph.linear.assembly import Assembly
from relnav_graph.linear.gtsam_extra import Piece
from relnav_graph.linear.gtsam_graph import Keys, read_any

__all__ = ["Part", "Tree", "check_depth"]

#: Bytes of stack for each epoch: several times what GTSAM's recursion was seen to take, 70 to 350.
DEPTH = 1000


def check_depth(epochs: int) -> None:
    """Raise EstimationError when so many epochs may be more than this thread's stack can hold:
    GTSAM walks its tree by recursion, and would end in a segmentation fault."""
    soft, _ = resource.getrlimit(resource.RLIMIT_STACK)
    if threading.current_thread() is not threading.main_thread():
        soft = threading.stack_size() or (2**21 if soft == resource.RLIM_INFINITY else soft)
    most = (soft - 2**18) // DEPTH if soft != resource.RLIM_INFINITY else epochs
    if epochs > most:
        raise EstimationError(
            f"found {epochs} epochs, expected at most {most} on a stack of {soft / 2**20:.3g} MiB:"
            " GTSAM's tree is walked by recursion. Give it a larger one (ulimit -s, or a thread"
            " with threading.stack_size), or use incremental or fixed_lag"
        )


@dataclass(frozen=True, eq=False)
class Part:
    """What went into the tree in one update; `before` it, another part or none.

    epochs, assembly, weights: of adjoining epochs, or none; factors, values: as GTSAM took them;
    x (size,): where the newest epoch is linearised, of all blocks; pieces: the user's, with it.
    """

    before: Part | None
    epochs: tuple[Epoch, ...]
    assembly: Assembly | None
    weights: Array
    factors: gtsam.NonlinearFactorGraph
    values: gtsam.Values
    x: Array
    pieces: tuple[Piece, ...]


class Tree:
    """An ISAM2 that is updated in order, and asked for the newest state, or for all."""

    def __init__(self, keys: Keys) -> None:
        params = gtsam.ISAM2Params()
        params.setFactorization("QR")
        params.enableRelinearization = False
        params.setOptimizationParams(gtsam.ISAM2GaussNewtonParams(1e9))  # the wildfire threshold
        self.keys = keys
        self._isam = gtsam.ISAM2(params)
        self._held = self._isam.getLinearizationPoint()

    def update(
        self, factors: gtsam.NonlinearFactorGraph, values: gtsam.Values, newest: int
    ) -> None:
        """Add factors and the values of their new variables; newest: number of the newest epoch.

        Raises EstimationError when they do not determine all variables, and what the models raise.
        The tree is then of no more use.
        """
        groups = gtsam.KeyGroupMap()
        for key in self._top(newest):  # at the root, where they are soonest asked for
            groups.insert2(key, 1)
        try:
            self._isam.update(factors, values, [], groups)
        except RelnavError:
            raise
        except (RuntimeError, ValueError, IndexError) as error:
            raise EstimationError(named(self.keys, error)) from error

    def _top(self, newest: int) -> list[int]:
        return self.keys.at(newest, self.keys.layout) if newest >= 0 else []

    def newest(self, epoch: int, x: Array) -> tuple[Array, Array]:
        """Estimate (size,) and covariance (n, n) of all blocks at the newest epoch.

        x (size,): where they are linearised. Raises EstimationError when they are not determined.
        """
        layout, parts = self.keys.layout, list[Array]()
        try:
            for block in layout:
                key = self.keys[block.name, epoch]
                if block.manifold == "SO3":
                    parts.append(self._isam.calculateEstimateRot3(key).matrix().ravel())
                else:
                    parts.append(self._isam.calculateEstimateVector(key))
            P = self._isam.jointMarginalCovariance(self._top(epoch)).fullMatrix()
        except (RuntimeError, ValueError, IndexError) as error:
            raise EstimationError(named(self.keys, error)) from error
        found = np.concatenate(parts)
        J = layout.right_jacobian(layout.local(x, found))
        P = J @ P @ J.T
        if not (np.isfinite(found).all() and np.isfinite(P).all()):
            raise EstimationError("the estimate is not finite")
        return found, 0.5 * (P + P.T)

    def variable(self, key: int) -> tuple[object, Array]:
        """Value and covariance (d, d) of one variable of whatever type.

        Raises EstimationError when it is not determined.
        """
        try:
            P = self._isam.marginalCovariance(key)
        except (RuntimeError, ValueError, IndexError) as error:
            raise EstimationError(named(self.keys, error)) from error
        if not np.isfinite(P).all():
            shown = gtsam.DefaultKeyFormatter(key)
            raise EstimationError(f"the factor graph does not determine variable {shown}")
        return read_any(self._isam.calculateBestEstimate(), key), P

    def best(self) -> gtsam.Values:
        """The estimate of all variables, solved through the whole tree."""
        return self._isam.calculateBestEstimate()

    def distance(self) -> float:
        """From the linearisation point to the estimate, in sigmas over all variables together."""
        return float(np.sqrt(2 * self._isam.error(self._held.zeroVectors())))


def named(keys: Keys, error: Exception) -> str:
    """What GTSAM says is wrong, with the block and epoch of the variable that it is near to."""
    found = re.search(r"variable\s+(\d+)", str(error))
    if found is None:
        return f"the factor graph: {str(error).strip()}"
    key = int(found[1])
    at = gtsam.DefaultKeyFormatter(key)
    if key in keys:
        name, epoch = keys.back(key)
        at = name if epoch is None else f"{name} at epoch {epoch}"
    return f"the factor graph does not determine {at}"
