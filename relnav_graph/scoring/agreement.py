"""How far the estimators of one pass are from each other, in sigmas.

All of them have the same models, prior and measurements, so that what they make of the whole of
it is one and the same: the optimum. Where an estimate is several sigmas away from it, one of
both is wrong, whatever their own status says.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from relnav_graph.core.cautions import Caution
from relnav_graph.core.track import Track

__all__ = ["REFERENCES", "distance_caution", "distances"]

#: Whose estimate stands for the optimum: the first of these that is there.
REFERENCES = ("batch", "rts")
#: Sigmas from which on a distance is a caution.
FAR = 3.0


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
    d = track.layout.local(reference.x[epochs], track.x[epochs])
    P = (track if track.kind == "fixed-lag" else reference).P[epochs]
    sigmas = np.abs(d) / np.sqrt(np.diagonal(P, axis1=1, axis2=2))
    largest = float(sigmas.max(initial=0.0))
    return largest if np.isfinite(largest) else None


def distances(tracks: Mapping[str, Track]) -> tuple[str, dict[str, float | None]]:
    """Name of the reference, "" without one, and each row's distance from it, in sigmas.

    tracks: by the name of their row, see `relnav_graph.scoring.metrics.with_smoothed`. None where
    there is nothing to compare: no reference, another state or other epochs, a pass of its own.
    """
    usable = {n: t for n, t in tracks.items() if t.truth is None and t.status != "diverged"}
    reference = next((name for name in REFERENCES if name in usable), "")
    return reference, {
        name: _apart(track, tracks[reference]) if reference and name in usable else None
        for name, track in tracks.items()
    }


def distance_caution(distance: float | None, track: Track, reference: str) -> tuple[Caution, ...]:
    """Where an estimate is further from the reference than chance and rounding can tell."""
    if distance is None or distance <= FAR:
        return ()
    where = "at the last epoch" if track.kind == "filtered" else "over the pass"
    return (Caution("distance", f"{distance:.3g} sigma from {reference} {where}"),)
