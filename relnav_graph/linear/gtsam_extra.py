"""What a user adds to a graph: native factors of GTSAM's, and variables of their own."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import gtsam
import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from relnav_graph.arrays import Array
from relnav_graph.core.state import Layout
from relnav_graph.errors import EstimationError, GeometryError, InputError, ModelError
from relnav_graph.linear.gtsam_factors import guarded
from relnav_graph.linear.gtsam_graph import Keys, read_any

__all__ = ["Extra", "Piece", "pieces"]

shown: Callable[[int], str] = gtsam.DefaultKeyFormatter


@dataclass(frozen=True, eq=False)
class Extra:
    """Factors to add to a problem's graph, and initial values of the variables that it lacks.

    The keys of the problem's own variables are those of `relnav_graph.linear.gtsam_graph.Keys`,
    ``Keys(problem.layout)[block, epoch]``; other keys are variables of yours, for which `values`
    must have an initial value, and which are in `Track.extra` in the end.
    """

    factors: gtsam.NonlinearFactorGraph
    values: gtsam.Values = field(default_factory=gtsam.Values)

    def save(self) -> dict[str, Array]:
        """Both as arrays of bytes (n,), by name. Raises InputError on what GTSAM cannot write: a
        `CustomFactor`, for one."""
        try:
            texts = {"factors": self.factors.serialize(), "values": self.values.serialize()}
        except RuntimeError as error:
            raise InputError(f"extra: cannot be saved: {str(error).strip()}") from error
        return {name: np.frombuffer(text.encode(), np.uint8) for name, text in texts.items()}

    @classmethod
    def load(cls, arrays: Mapping[str, Array]) -> Extra:
        """What :meth:`save` made arrays (n,) of."""
        factors, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
        for target, name in ((factors, "factors"), (values, "values")):
            target.deserialize(np.asarray(arrays[name], np.uint8).tobytes().decode())
        return cls(factors, values)


@dataclass(frozen=True, eq=False)
class Piece:
    """Factors that share variables of the user's, which are told by all of them together only.

    own: those variables, new with it; values: theirs; first: number of the earliest epoch, and
    last: of the latest one, that it names, -1 where it names none.
    """

    factors: tuple[gtsam.NonlinearFactor, ...]
    values: gtsam.Values
    own: tuple[int, ...]
    first: int
    last: int

    def __str__(self) -> str:
        keys = sorted({key for factor in self.factors for key in list(factor.keys())})
        return f"{len(self.factors)} extra factors of {', '.join(shown(k) for k in keys)}"


def pieces(extra: Extra, keys: Keys, x: Array, known: gtsam.Values) -> list[Piece]:
    """The parts of an `Extra` that hang together, checked before GTSAM sees them in earnest.

    x (size,): a state of all blocks, where factors are tried; known: values of the user's earlier
    variables. Raises InputError, naming the factor and the key, on a key that is unknown, of
    another type or size; on a value that is not finite, of a block, given twice, or in no factor;
    on a noise model that is none; on what is no factor, and on a `CustomFactor` that raises there,
    or gives residuals or Jacobians of another shape, or not finite. It is looked at whenever it is
    evaluated later, too.
    """
    if not isinstance(extra, Extra):
        raise InputError(f"extra: found {type(extra).__name__}, expected an Extra(factors, values)")
    if not isinstance(extra.factors, gtsam.NonlinearFactorGraph) or not isinstance(
        extra.values, gtsam.Values
    ):
        raise InputError(
            "extra: found"
            f" {type(extra.factors).__name__} and {type(extra.values).__name__}, expected a"
            " gtsam.NonlinearFactorGraph and gtsam.Values"
        )
    new = [int(k) for k in list(extra.values.keys())]
    for key in new:
        if key in keys:
            name, epoch = keys.back(key)
            raise InputError(
                f"extra: found a value of {shown(key)}, which is {name} of epoch {epoch}: the"
                " estimator has it; expected values of variables of your own only"
            )
        if known.exists(key):
            raise InputError(f"extra: found a second value of {shown(key)}")
        numbers = _numbers(read_any(extra.values, key))
        if not numbers.size:
            raise InputError(f"extra: found no number in the value of {shown(key)}, expected some")
        if not np.isfinite(numbers).all():
            raise InputError(
                f"extra: found {numbers} as the value of {shown(key)}, expected finite numbers"
            )
    factors = [extra.factors.at(i) for i in range(extra.factors.size())]
    trial = gtsam.Values(known)
    trial.insert(extra.values)
    for i, factor in enumerate(factors):
        if factor is None:
            raise InputError(f"extra: found no factor in place {i}")
        where = f"extra: factor {i} ({type(factor).__name__})"
        factors[i] = _check(where, factor, keys, x, trial)
    touched = {int(key) for factor in factors for key in list(factor.keys())}
    for key in new:
        if key not in touched:
            raise InputError(f"extra: found a value of {shown(key)}, which is in no factor")
    return [_piece(group, keys, extra.values, new) for group in _together(factors, set(new))]


def _numbers(value: Any) -> Array:
    """The numbers (any shape) in a value of GTSAM's; none where it has no matrix."""
    found = np.asarray(value.matrix() if hasattr(value, "matrix") else value)
    return found if found.dtype.kind == "f" else np.zeros(())


#: What GTSAM says of a value or noise model of another type or size.
_MISFIT = ("requested type", "fixed-size", "dimension", "mis-match")


def _check(
    where: str, factor: gtsam.NonlinearFactor, keys: Keys, x: Array, values: gtsam.Values
) -> gtsam.NonlinearFactor:
    """A factor, guarded if it is made of Python. Raises InputError unless it fits its variables;
    adds those of blocks to `values`."""
    own = [int(key) for key in list(factor.keys())]
    if not own:
        raise InputError(f"{where}: found no key, expected one or more")
    noise = factor.noiseModel() if hasattr(factor, "noiseModel") else None
    if isinstance(factor, gtsam.CustomFactor) and noise is None:
        raise InputError(f"{where}: found no noise model, expected one")
    if isinstance(noise, gtsam.noiseModel.Diagonal):
        sigmas = np.asarray(noise.sigmas())
        if not ((sigmas > 0) | ((sigmas == 0) & noise.isConstrained())).all():
            raise InputError(f"{where}: found sigmas {sigmas}, expected positive ones")
    for key in own:
        if key in keys and not values.exists(key):
            name, epoch = keys.back(key)
            keys.insert(values, epoch or 0, Layout([keys.layout.block(name)]), _of(keys, x, name))
        elif not values.exists(key):
            blocks = ", ".join(block.name for block in keys.layout)
            raise InputError(
                f"{where}: found key {shown(key)}, expected one of a block ({blocks}), or of a"
                " variable of your own that has a value"
            )
    dims = values.dims()
    for name in ("prior", "measured"):  # GTSAM does not look, and reads beyond what is shorter
        value = getattr(factor, name)() if hasattr(factor, name) else np.zeros(())
        numbers = _numbers(value)
        if not np.isfinite(numbers).all():
            raise InputError(f"{where}: found {name} {numbers}, expected finite numbers")
        for key in own if "Vector" in type(factor).__name__ and numbers.shape else ():
            if numbers.shape != (dims[key],):
                raise InputError(
                    f"{where}: found {name} of {numbers.size} numbers for {shown(key)}, expected"
                    f" {dims[key]}"
                )
    if isinstance(factor, gtsam.CustomFactor):
        factor = guarded(where, factor, [dims[key] for key in own])
    try:
        linear = factor.linearize(values)
    except (ModelError, EstimationError) as error:  # of what is guarded
        raise InputError(str(error)) from error
    except (RuntimeError, ValueError) as error:
        if not any(word in str(error) for word in _MISFIT):
            return factor  # impossible there, which may be otherwise where it counts
        raise InputError(
            f"{where}: does not fit {', '.join(map(shown, own))}: {str(error).strip()}"
        ) from error
    except GeometryError:
        return factor
    if linear is not None and linear.jacobian()[0].shape[1] != sum(dims[key] for key in own):
        raise InputError(f"{where}: its Jacobian does not fit {', '.join(map(shown, own))}")
    return factor


def _of(keys: Keys, x: Array, name: str) -> Array:
    """The stored values of one block of a state."""
    part: Array = x[keys.layout.stored(name)]
    return part


def _together(
    factors: Sequence[gtsam.NonlinearFactor], new: set[int]
) -> Iterable[list[gtsam.NonlinearFactor]]:
    """The factors in groups that share new variables."""
    ends: dict[int, int] = {}
    rows, columns = [], []
    for i, factor in enumerate(factors):
        for key in new.intersection(int(k) for k in list(factor.keys())):
            rows.append(i)
            columns.append(ends.setdefault(key, i))
    tied = coo_array((np.ones(len(rows)), (rows, columns)), shape=2 * (len(factors),))
    count, group = connected_components(tied, directed=False)
    return [[f for f, g in zip(factors, group, strict=True) if g == i] for i in range(count)]


def _piece(
    factors: list[gtsam.NonlinearFactor], keys: Keys, values: gtsam.Values, new: list[int]
) -> Piece:
    touched = {int(key) for factor in factors for key in list(factor.keys())}
    own = tuple(key for key in new if key in touched)
    epochs = [keys.back(key)[1] for key in touched if key in keys]
    named = [epoch for epoch in epochs if epoch is not None]
    part = values.extract(list(own))
    return Piece(tuple(factors), part, own, min(named, default=-1), max(named, default=-1))
