"""Errors of a track against truth, and their normalised squares.

Errors are tangent vectors from the estimate to the truth, in the coordinates of the
covariances: ``Log(R_est^T R_true)`` for an attitude, truth minus estimate for a vector.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import reduce

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtri

from relnav_graph.arrays import Array, Indices, finite
from relnav_graph.core.contracts import Ambiguous, Derived
from relnav_graph.core.models import derived_quantities, evaluate
from relnav_graph.core.scored import InAxes
from relnav_graph.core.state import Block, Layout
from relnav_graph.core.track import Track, Truth
from relnav_graph.errors import InputError
from relnav_graph.scoring.truth_noise import (
    Linear,
    TruthNoise,
    joint_noise,
    noise_of,
    of_error,
    stacked,
)

__all__ = [
    "StateErrors",
    "StateEstimates",
    "at_the_end",
    "chi2_band",
    "derived_estimates",
    "deviations",
    "errors",
    "estimates",
    "finite",
    "joint",
    "mean_nees",
    "nees",
]

Band = tuple[float, float]

#: An eigenvalue of a correlation matrix below this fraction of the largest counts as zero:
#: a constraint leaves about 1e-16, from rounding.
_RANK = 1e-12


@dataclass(frozen=True, eq=False)
class StateEstimates:
    """One state over a pass: value (N, 3, 3) or (N, dim), P (N, dim, dim), SI; constant: whether it
    is a static block, or derived of such alone.

    members: of a family of numbered blocks, whose values stand one after the other, (N, k dim);
    nearest: where several values say the same, see `relnav_graph.core.contracts.Ambiguous`;
    of: where it takes the place of a block of the state, how it depends on the track's blocks.
    """

    block: Block
    value: Array
    P: Array
    constant: bool = False
    members: tuple[Block, ...] = ()
    nearest: Callable[[Array, Array], Array] | None = None
    of: Linear | None = None

    def to(self, other: Array, rows: NDArray[np.bool_] | slice = slice(None)) -> Array:
        """Tangent vectors (M, dim) from M of these values to others (M, 3, 3) or (M, dim)."""
        own = self.value[rows]
        return self.block.local(own, other if self.nearest is None else self.nearest(other, own))


@dataclass(frozen=True, eq=False)
class StateErrors:
    """One state where truth knows it: t (N,) s, e (N, dim) and P (N, dim, dim), SI; members: of a
    family of numbered blocks, the errors of which stand one after the other; of: see
    `StateEstimates`; noise: of the truth itself, where it has any."""

    block: Block
    t: Array
    e: Array
    P: Array
    members: tuple[Block, ...] = ()
    of: Linear | None = None
    noise: TruthNoise | None = None

    def where(self, mask: NDArray[np.bool_]) -> StateErrors:
        """The epochs of a mask (N,)."""
        of, noise = self.of and self.of.where(mask), self.noise and self.noise.where(mask)
        return replace(self, t=self.t[mask], e=self.e[mask], P=self.P[mask], of=of, noise=noise)

    @property
    def S(self) -> Array:
        """P + T (N, dim, dim), SI: the covariance of e, with that of the truth."""
        return self.P if self.noise is None else self.P + self.noise.T

    @property
    def blocks(self) -> tuple[Block, ...]:
        """The blocks of the errors: one, or the members of a family."""
        return self.members or (self.block,)


@np.errstate(over="ignore", invalid="ignore")  # of diverged tracks
def estimates(track: Track, derived: Sequence[Derived]) -> dict[str, StateEstimates]:
    """Estimates of every block of the track and of every derived quantity that its blocks give.

    Numbered blocks are not among them: a family of them is one state, see
    `relnav_graph.scoring.maps`.

    Of a pass flown under control also the control errors: their "estimate" is the set point,
    zero, with a covariance of NaN.

    A derived quantity with the name of a block is left out: the block is the estimate.
    """
    own = {b.name: b for b in track.blocks if b.number is None}
    moving = set(track.layout.blocks)
    found = {
        n: StateEstimates(b, track.value(n), track.covariance(n), b not in moving)
        for n, b in own.items()
    }
    for quantity in derived:
        # The blocks, not only their names: a position in another frame is another block.
        instead = isinstance(quantity, InAxes)
        known = set(quantity.reads) <= set(own.values())
        if (quantity.block.name in own and not instead) or not known:
            continue
        names = [b.name for b in quantity.reads]
        value, jacobian = evaluate(quantity, [track.value(n) for n in names])
        P = jacobian @ track.covariance(*names) @ jacobian.transpose(0, 2, 1)
        if instead:
            of = Linear(tuple(quantity.reads), jacobian)
            found[quantity.block.name] = StateEstimates(quantity.block, value, P, of=of)
            continue
        constant = moving.isdisjoint(quantity.reads)
        twins = quantity.nearest if isinstance(quantity, Ambiguous) else None
        found[quantity.block.name] = StateEstimates(
            quantity.block, value, P, constant, nearest=twins
        )
    for block in track.controlled:
        one = np.eye(3) if block.manifold == "SO3" else np.zeros(block.dim)
        aim = np.tile(one, (len(track.t), *([1] * one.ndim)))
        unknown = np.full((len(track.t), block.dim, block.dim), np.nan)
        found[block.name] = StateEstimates(block, aim, unknown)
    return found


def derived_estimates(track: Track) -> dict[str, StateEstimates]:
    """Estimates of every derived quantity that is known and that the blocks of a track give."""
    found = estimates(track, derived_quantities(Layout(track.blocks)))
    own = {b.name for b in (*track.blocks, *track.controlled)}
    return {name: state for name, state in found.items() if name not in own}


@dataclass(frozen=True, eq=False)
class _True:
    """True values at the epochs of a track, and what of them is noise."""

    value: Array
    noise: TruthNoise | None


def _truth_at(
    t: Array, truth: Truth, derived: Sequence[Derived], own: Mapping[str, Block]
) -> dict[str, _True]:
    """Truth at times t (N,), s, by name; own: blocks of what it may know, by name.

    Raises InputError on a time that truth lacks.
    """
    rows, known = truth.at(t)
    if not known.all():
        raise InputError(f"truth {truth.source!r}: no epoch at {t[~known][0]} s")
    values, found = {}, {}
    for name, value in truth.values.items():
        if len(value) != len(truth.t):
            raise InputError(f"truth of {name!r}: {len(value)} values at {len(truth.t)} times")
        values[name] = np.ascontiguousarray(value[rows], dtype=np.float64)
        block = own.get(name)
        one = np.tile(np.eye(block.dim), (len(t), 1, 1)) if block else np.zeros(0)
        noise = noise_of([block], one, truth.sigmas, rows) if block else None
        found[name] = _True(values[name], noise)
    for quantity in derived:
        name, names = quantity.block.name, [b.name for b in quantity.reads]
        new = name not in values or isinstance(quantity, InAxes)
        if new and all(n in values for n in names):
            value, J = evaluate(quantity, [values[n] for n in names])
            reads: Sequence[Block] = quantity.reads
            if name in truth.sigmas and not isinstance(quantity, InAxes):  # said of itself
                reads, J = [quantity.block], np.tile(np.eye(quantity.block.dim), (len(t), 1, 1))
            found[name] = _True(value, noise_of(reads, J, truth.sigmas, rows))
    return found


@np.errstate(over="ignore", invalid="ignore")
def deviations(
    states: Mapping[str, StateEstimates], t: Array, truth: Truth, derived: Sequence[Derived]
) -> dict[str, StateErrors]:
    """:func:`errors` of estimates already at hand, at times t (N,), s."""
    known = _truth_at(t, truth, derived, {name: state.block for name, state in states.items()})
    found = {}
    for name, state in states.items():
        if name not in known:
            continue
        true, block = known[name].value, state.block
        if true.shape != state.value.shape:
            raise InputError(f"truth of {name!r}: {true.shape}, expected {state.value.shape}")
        keep = finite(true)
        e, noise = state.to(true[keep], keep), known[name].noise
        of, turned = state.of, None
        if noise is not None:
            if state.nearest is not None and block.manifold == "SO3":
                meant = state.nearest(true[keep], state.value[keep])
                turned = np.swapaxes(true[keep], 1, 2) @ meant
            noise = of_error(noise.where(keep), block, e, turned)
        found[name] = StateErrors(
            block, t[keep], e, state.P[keep], of=of and of.where(keep), noise=noise
        )
    return found


def errors(track: Track, truth: Truth, derived: Sequence[Derived]) -> dict[str, StateErrors]:
    """Errors of every block and derived quantity that truth knows, at its epochs.

    The truth of a derived quantity follows from true blocks where it is not given. Epochs
    where truth is NaN are left out. Raises InputError when truth lacks a time of the
    track (within a microsecond) or has values of the wrong shape.
    """
    return deviations(estimates(track, derived), track.t, truth, derived)


def joint(
    found: Iterable[StateErrors], track: Track, layout: Layout, truth_noise: bool = True
) -> tuple[Array, Array]:
    """Errors (M, n) and joint covariance (M, n, n) of those blocks of a layout that truth knows.

    layout: of the track's epochs, or of its statics; truth_noise: whether the covariance of the
    truth is counted. SI, in tangent coordinates; of the M epochs at which truth knows all of them.
    """
    states = [s for s in found if all(b.name in layout for b in s.blocks)]
    if not states:
        return np.zeros((0, 1)), np.zeros((0, 1, 1))
    common = reduce(np.intersect1d, [s.t for s in states])
    states = [s.where(np.isin(s.t, common)) for s in states]
    e, names = np.hstack([s.e for s in states]), [b.name for s in states for b in s.blocks]
    epochs = track.at(np.isin(track.t, common))
    if any(s.of is not None for s in states):
        parts = [s.of or _themselves(s) for s in states]
        names = list(dict.fromkeys(b.name for part in parts for b in part.blocks))
        J = stacked(parts, names)
        P = J @ epochs.covariance(*names) @ J.transpose(0, 2, 1)
    else:
        P = epochs.covariance(*names)
    if truth_noise and any(s.noise is not None for s in states):
        P = P + joint_noise([s.noise for s in states], [s.e.shape[1] for s in states], len(e))
    return e, P


def _themselves(s: StateErrors) -> Linear:
    return Linear(s.blocks, np.tile(np.eye(s.e.shape[1]), (len(s.e), 1, 1)))


def at_the_end(constants: Mapping[str, StateErrors]) -> dict[str, StateErrors]:
    """Errors (1, dim) of constants that truth knows, at the last epoch at which it knows all of
    them: what a filter has learned of a constant is what it ends with."""
    common = reduce(np.intersect1d, [s.t for s in constants.values()]) if constants else np.zeros(0)
    if not len(common):
        return {}
    return {name: s.where(s.t == common[-1]) for name, s in constants.items()}


def nees(e: Array, P: Array) -> tuple[Array, Indices]:
    """Normalised estimation error squared, NEES = ``e^T P^+ e`` (N,), and the rank of P (N,).

    e (N, dim): errors; P (N, dim, dim): their covariances.

    The pseudo-inverse is taken of the correlation matrix, so that units do not decide the
    rank, and quantities bound by a constraint (three inertia ratios of two parameters) count
    with their true number of degrees of freedom. NaN where e or P is not finite
    or P is not a covariance.
    """
    value, rank = np.full(len(e), np.nan), np.zeros(len(e), dtype=np.int64)
    ok = finite(e, P)
    variance = np.diagonal(P[ok], axis1=1, axis2=2)
    scale = np.sqrt(np.where(variance > 0, variance, 1.0))
    w, V = np.linalg.eigh(P[ok] / scale[:, :, None] / scale[:, None, :])
    keep = w > _RANK * w[:, -1:]
    y = np.einsum("kij,ki->kj", V, e[ok] / scale)
    total = np.where(keep, y**2 / np.where(keep, w, 1.0), 0.0).sum(axis=1)
    broken = (variance < 0).any(axis=1) | (w[:, 0] < -1e-9) | ~keep.any(axis=1)
    value[ok], rank[ok] = np.where(broken, np.nan, total), keep.sum(axis=1)
    return value, rank


def chi2_band(n: int, runs: int = 1, level: float = 0.95) -> Band:
    """Two-sided band, of probability `level`, of a mean of NEES / n over independent runs.

    n: degrees of freedom of one run; with m = n runs, the quantiles of chi2(m) / m.
    """
    freedoms, tail = n * runs, (1 - level) / 2
    low, high = chdtri(freedoms, 1 - tail), chdtri(freedoms, tail)  # chdtri: upper tail
    return float(low) / freedoms, float(high) / freedoms


def mean_nees(e: Array, P: Array) -> tuple[float | None, int]:
    """ANEES = mean over epochs of NEES / rank, and the largest rank: the degrees of freedom.

    e (N, dim): errors; P (N, dim, dim): their covariances.

    None without a finite value, or without epochs.
    """
    value, rank = nees(e, P)
    if not len(value) or not np.isfinite(value).all():
        return None, 0
    return float(np.mean(value / rank)), int(rank.max())
