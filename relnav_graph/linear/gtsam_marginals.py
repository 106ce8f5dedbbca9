"""Covariances of a GTSAM graph of any shape, by QR.

`gtsam.Marginals` eliminates by Cholesky alone, which throws on ordinary ratios of process to state
noise. Here groups of variables (epochs) are eliminated by QR in order of time, the rest (static
blocks, variables of a user's own) last. From the conditionals R_k y_k + sum_j S_kj y_j = d_k, j
later groups, the covariances follow backwards:

    P_kt = sum_j G_kj P_jt,   P_kk = R_k^-1 R_k^-T + sum_j P_kj G_kj^T,   G_kj = -R_k^-1 S_kj

for those pairs alone that an earlier group needs (Golub and Plemmons 1980 have it for a chain).
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import gtsam
import numpy as np

from relnav_graph.arrays import Array
from relnav_graph.errors import EstimationError
from relnav_graph.maths.dense import inverse_upper

__all__ = ["Marginals", "marginals"]


@dataclass(frozen=True, eq=False)
class Marginals:
    """Step and covariances of the N groups and of the border of a linear graph.

    step (N, n) and border_step (b,): from the linearisation point to the linear optimum; P
    (N, n, n): of each group; cross (N, n, b): with the border; border (b, b); dims: of each
    variable; distance: length of the step, in sigmas over all variables together.
    """

    step: Array
    border_step: Array
    P: Array
    cross: Array
    border: Array
    dims: Mapping[int, int]
    distance: float


@dataclass(frozen=True, eq=False)
class _Conditional:
    """R y + sum of S[j] y_j = d of a group; j: numbers of later groups."""

    R: Array
    S: dict[int, Array]
    d: Array


def _undetermined(key: int) -> EstimationError:
    shown = gtsam.DefaultKeyFormatter(key)
    return EstimationError(f"the factor graph does not determine variable {shown}")


def _conditionals(
    linear: gtsam.GaussianFactorGraph, groups: Sequence[Sequence[int]]
) -> tuple[list[_Conditional], dict[int, int]]:
    """Those of all groups, eliminated in this order, and the dimension of each variable.

    Raises EstimationError, naming a variable, when the graph does not determine it.
    """
    ordering, place = gtsam.Ordering(), dict[int, tuple[int, int]]()
    keys = [key for group in groups for key in group]
    held = {key for i in range(linear.size()) for key in linear.at(i).keys()}  # noqa: SIM118
    for key in keys:
        if key not in held:
            raise _undetermined(key)
        ordering.push_back(key)
    try:
        net = linear.eliminateSequential(ordering, gtsam.EliminateQR)
    except RuntimeError as error:
        raise _undetermined(int(re.findall(r"\d+", str(error))[0])) from error
    each = [net.at(i) for i in range(net.size())]
    found = {c.firstFrontalKey(): (c.R(), c.S(), c.d(), c.keys()) for c in each}
    dims, sizes = {key: len(R) for key, (R, *_) in found.items()}, list[int]()
    for g, group in enumerate(groups):
        sizes.append(0)
        for key in group:
            place[key] = g, sizes[g]
            sizes[g] += dims[key]
    out = []
    for g, group in enumerate(groups):
        n = sizes[g]
        one = _Conditional(np.zeros((n, n)), {}, np.zeros(n))
        for key in group:
            R, S, d, keys = found[key]
            if not np.isfinite(R).all() or not np.diag(R).all():
                raise _undetermined(key)
            at = place[key][1]
            rows, first = slice(at, at + dims[key]), 0
            one.R[rows, rows], one.d[rows] = R, d
            for other in list(keys)[1:]:
                j, column = place[other]
                part = one.R if j == g else one.S.setdefault(j, np.zeros((n, sizes[j])))
                part[rows, column : column + dims[other]] = S[:, first : first + dims[other]]
                first += dims[other]
        out.append(one)
    return out, dims


def marginals(
    linear: gtsam.GaussianFactorGraph, groups: Sequence[Sequence[int]], border: Sequence[int]
) -> Marginals:
    """Step and covariances of groups of variables, and of a border, to which all may be tied.

    groups: keys of each, in the order of elimination, all of one dimension n; border: keys of all
    others. Raises EstimationError, naming a variable, when the graph does not determine it.
    """
    c, dims = _conditionals(linear, [*groups, border])
    last = len(groups)
    needed, carried = list[set[int]](), set[int]()
    for k in range(last):
        carried = (carried | set(c[k].S) | {last}) - {k}
        needed.append(carried)
    P: list[dict[int, Array]] = [{} for _ in c]
    steps: list[Array] = [np.zeros(0) for _ in c]
    for k in range(last, -1, -1):
        root = inverse_upper(c[k].R)
        G = {j: -root @ S for j, S in c[k].S.items()}
        steps[k] = root @ c[k].d + sum((G[j] @ steps[j] for j in G), np.zeros(len(root)))
        for t in needed[k] if k < last else ():
            zero = np.zeros((len(root), len(c[t].R)))
            P[k][t] = sum((G[j] @ (P[j][t] if j <= t else P[t][j].T) for j in G), zero)
        own = root @ root.T + sum((P[k][j] @ G[j].T for j in G), np.zeros(root.shape))
        P[k][k] = 0.5 * (own + own.T)
    return Marginals(
        step=np.array(steps[:last]),
        border_step=steps[last],
        P=np.array([P[k][k] for k in range(last)]),
        cross=np.array([P[k][last] for k in range(last)]),
        border=P[last][last],
        dims=dims,
        distance=float(np.sqrt(sum(float(one.d @ one.d) for one in c))),
    )
