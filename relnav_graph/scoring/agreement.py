"""How far the estimators of one pass are from each other, in sigmas.

All of them have the same models, prior and measurements, so that what they make of the whole of
it is one and the same: the optimum. Where an estimate is several sigmas away from it, one of
both is wrong, whatever their own status says.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from threadpoolctl import threadpool_limits

from relnav_graph.arrays import Array
from relnav_graph.core.cautions import Caution
from relnav_graph.core.state import Block
from relnav_graph.core.track import Track
from relnav_graph.estimators.considered import CONSIDERED
from relnav_graph.estimators.second_look import SECOND_LOOK
from relnav_graph.scoring.bent_axes import axes_cautions
from relnav_graph.scoring.wandering import wandering_cautions

__all__ = ["REFERENCES", "distances", "row_cautions"]

#: Whose estimate stands for the optimum: the first of these that is there.
REFERENCES = ("batch", "rts")
#: Sigmas from which on a distance is a caution.
FAR = 3.0
#: Mean square of the distance from the reference, in a filter's own sigmas, that is a caution.
OVERCONFIDENT = 3.0
#: The part of the reference's sigma, of the same data, below which a sigma is a caution.
NARROW = 0.5
#: Epochs whose joint covariances are made at a time: with many static blocks they are large.
_AT_ONCE = 500


@np.errstate(over="ignore", invalid="ignore", divide="ignore")  # diverged tracks: None in the end
def _apart(track: Track, reference: Track) -> float | None:
    """The largest component of track less reference, in sigmas.

    Of smoothed estimates, over the pass, in the reference's sigmas. Of filtered ones at the last
    epoch, before which they have not seen as much. Of fixed-lag ones, which have seen a little less
    throughout, over the pass, in their own sigmas, which cover that.
    """
    if track.layout != reference.layout or not np.array_equal(track.t, reference.t):
        return None
    epochs = slice(-1, None) if track.kind == "filtered" else slice(None)
    a, b = reference.at(epochs), track.at(epochs)
    whose, sigmas = b if track.kind == "fixed-lag" else a, []
    for block in _shared(a, b):
        variance = np.diagonal(whose.covariance(block.name), axis1=1, axis2=2)
        sigmas.append(np.abs(_apart_in(block, a, b)) / np.sqrt(variance))
    largest = float(np.hstack(sigmas).max(initial=0.0))
    return largest if np.isfinite(largest) else None


@np.errstate(over="ignore", invalid="ignore", divide="ignore")
def _apart_from_own(track: Track, smoothed: Track) -> float | None:
    """How far a filter was from what it ends with, smoothed, in its own sigmas: of the component
    that was furthest, the root mean square over the last three quarters of the pass.

    At the last epoch both are the same by construction. It is at most 1 in the mean where both are
    consistent.
    """
    if track.layout != smoothed.layout or not np.array_equal(track.t, smoothed.t):
        return None
    epochs, found = slice(len(track.t) // 4, None), list[Array]()
    a, b = smoothed.at(epochs), track.at(epochs)
    for block in _shared(a, b):
        variance = np.diagonal(b.covariance(block.name), axis1=1, axis2=2)
        found.append(np.sqrt((_apart_in(block, a, b) ** 2 / variance).mean(axis=0)))
    largest = float(np.hstack(found).max(initial=0.0))
    return largest if np.isfinite(largest) else None


def _shared(a: Track, b: Track) -> list[Block]:
    """The blocks that both have, static ones included."""
    return [block for block in a.blocks if block in b.blocks]


def _apart_in(block: Block, a: Track, b: Track) -> Array:
    """Tangent vectors (N, dim) of a block from the track a to b."""
    return block.local(a.value(block.name), b.value(block.name))


def distances(
    tracks: Mapping[str, Track],
) -> tuple[dict[str, str], dict[str, float | None]]:
    """Each row's reference, "" without one, and its distance from it, in sigmas.

    tracks: by the name of their row, see `relnav_graph.scoring.metrics.with_smoothed`. The
    reference is the first of `REFERENCES` that is there; else, of an online estimator, what it ends
    with, smoothed, see `_apart_from_own`. None where there is nothing to compare: no reference,
    another state or other epochs, a pass of its own.
    """
    usable = {n: t for n, t in tracks.items() if t.truth is None and t.status != "diverged"}
    best = next((name for name in REFERENCES if name in usable), "")
    references = {}
    for name in tracks:
        own = best or f"{name}_smoothed"
        references[name] = own if own in usable and name in usable else ""
    measure = _apart if best else _apart_from_own
    return references, {
        name: measure(track, tracks[references[name]]) if references[name] else None
        for name, track in tracks.items()
    }


def _overconfidence(track: Track, reference: Track) -> float:
    """Mean of (x - r)^T P^-1 (x - r) / n over the last three quarters of the pass, of a filter's
    estimates x, with covariances P (n, n), against the reference r.

    At most 1 in the mean where both are consistent: x - r has the covariance P less that of r. Not
    so where something is considered: each estimate is then drawn by it in a way of its own.
    """
    blocks, squares = _shared(reference, track), []
    for begin in range(len(track.t) // 4, len(track.t), _AT_ONCE):
        epochs = slice(begin, begin + _AT_ONCE)
        a, b = reference.at(epochs), track.at(epochs)
        d = np.hstack([_apart_in(block, a, b) for block in blocks])
        P = b.covariance(*(block.name for block in blocks))
        try:
            with threadpool_limits(1, "blas"):  # threads wait for each other on small matrices
                white = np.linalg.solve(np.linalg.cholesky(P), d[:, :, None])
        except np.linalg.LinAlgError:
            return 0.0
        squares.append(np.square(white).sum(axis=1))
    return float(np.concatenate(squares).mean() / sum(block.dim for block in blocks))


def _narrowest(track: Track, reference: Track) -> tuple[float, str]:
    """Of a filter at the last epoch, where it has seen as much as the reference: the smallest part
    of the reference's sigma that its own is in any direction of a block, and of which block."""
    found = []
    for block in _shared(reference, track):
        P, own = (t.at(slice(-1, None)).covariance(block.name)[0] for t in (reference, track))
        try:
            with threadpool_limits(1, "blas"):
                white = np.linalg.inv(np.linalg.cholesky(P))
                part = float(np.linalg.eigvalsh(white @ own @ white.T).min())
        except np.linalg.LinAlgError:
            continue
        found.append((float(np.sqrt(max(part, 0.0))), block.name))
    return min(found, default=(1.0, ""))


def row_cautions(
    rows: Mapping[str, Track],
    references: Mapping[str, str],
    apart: Mapping[str, float | None],
) -> dict[str, tuple[Caution, ...]]:
    """The cautions of each row: its own, what comparing it with the reference says, and those of
    badly known axes and of constants that a filter has given up.

    rows, references, apart: as of `distances`. A posterior that is bent for the reference is so
    for all that estimate the same pass.
    """
    found = {}
    for name, track in rows.items():
        own, distance, reference = list(track.cautions), apart[name], references[name]
        bent = [c for c in rows[reference].cautions if c.name == SECOND_LOOK] if reference else []
        if distance is not None and not any(c.name == SECOND_LOOK for c in own):
            own += [Caution(SECOND_LOOK, f"of {reference}: {c.text}") for c in bent]
        considered = any(c.name == CONSIDERED for c in own)
        if distance is not None and distance > FAR:
            where = "at the last epoch" if track.kind == "filtered" else "over the pass"
            if reference not in REFERENCES:
                where = "on average over the last three quarters of the pass"
            own.append(Caution("distance", f"{distance:.3g} sigma from {reference} {where}"))
        elif distance is not None and track.kind != "smoothed" and not considered:
            ratio = _overconfidence(track, rows[reference])
            if ratio > OVERCONFIDENT:
                text = (
                    f"squared distance from {reference}, in its own sigmas, {ratio:.3g} times what"
                    " its covariance allows, on average over the last three quarters of the pass"
                )
                own.append(Caution("overconfident", text))
            part, block = _narrowest(track, rows[reference])
            if ratio <= OVERCONFIDENT and track.kind == "filtered" and part < NARROW:
                text = (
                    f"at the last epoch, where {reference} has seen no more, a sigma of {block} is"
                    f" {part:.2g} of that of {reference}"
                )
                own.append(Caution("overconfident", text))
        found[name] = (*own, *axes_cautions(track), *wandering_cautions(track))
    return found
