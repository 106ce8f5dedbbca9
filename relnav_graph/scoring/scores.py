"""The scores of a track against truth, as numbers."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from relnav_graph.arrays import Array
from relnav_graph.core.track import Kind
from relnav_graph.scoring.deviations import Band, chi2_band

__all__ = ["Score", "StateScore"]


@dataclass(frozen=True, eq=False)
class StateScore:
    """Scores of one state in table units; None where the track holds no finite number.

    rmse: sqrt(mean |e|^2), a norm over the axes; rmse_last: the same at the last epoch;
    sigma: sqrt(mean trace P); anees: mean NEES / rank; freedoms: the rank, degrees of freedom
    of one run; inside_1sigma to 3: fraction of the components within so many sigma; t (M,):
    epochs compared, s, empty where truth knows none (then only unit and sigma are set);
    anees_without_truth_noise: as if the truth were exact, None where it is. (sigma is the
    estimator's own; anees and inside count the truth's covariance too.)
    """

    unit: str
    sigma: float | None
    t: Array = field(default_factory=lambda: np.zeros(0))
    rmse: float | None = None
    rmse_last: float | None = None
    anees: float | None = None
    freedoms: int = 0
    inside_1sigma: float | None = None
    inside_2sigma: float | None = None
    inside_3sigma: float | None = None
    count: int | None = None
    anees_without_truth_noise: float | None = None

    @property
    def anees_band(self) -> Band | None:
        """95 % band of one run; its epochs are correlated, so they do not narrow it."""
        return None if self.anees is None else chi2_band(self.freedoms)


@dataclass(frozen=True, eq=False)
class Score:
    """Scores of a track.

    states: of all blocks and derived quantities over the pass, but for numbered blocks; anees: of
    all blocks of the epochs that truth knows, jointly; statics: of the static blocks, of families
    of numbered ones, and of what is derived of them alone, at the last epoch, which for a smoothed
    track is every epoch; statics_anees: of all static blocks that truth knows, jointly;
    anees_without_truth_noise: anees as if the truth were exact, None where it is; anees_without:
    anees without the blocks that the scenario leaves out of it, None where it names none.
    """

    name: str
    kind: Kind
    states: Mapping[str, StateScore]
    anees: float | None = None
    freedoms: int = 0
    statics: Mapping[str, StateScore] = field(default_factory=dict)
    statics_anees: float | None = None
    statics_freedoms: int = 0
    anees_without_truth_noise: float | None = None
    anees_without: float | None = None
    freedoms_without: int = 0

    @property
    def anees_without_band(self) -> Band | None:
        """95 % band of one run."""
        return None if self.anees_without is None else chi2_band(self.freedoms_without)

    @property
    def anees_band(self) -> Band | None:
        """95 % band of one run."""
        return None if self.anees is None else chi2_band(self.freedoms)

    @property
    def statics_anees_band(self) -> Band | None:
        """95 % band of one run."""
        return None if self.statics_anees is None else chi2_band(self.statics_freedoms)
