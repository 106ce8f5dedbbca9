"""Estimators driven online: one epoch at a time, late data put where they belong.

`Online` has the rules that are the same for every estimator: what is refused and counted, in
which order epochs are taken in, when an estimate is to be trusted. It drives an `Engine`,
which knows how to estimate and whose state is an immutable value. So a step is a
transaction: it makes a new state and swaps it in at the very end, and whatever happens
before (a model that raises, Ctrl-C) leaves the old one, bit for bit. And a late measurement
goes back to the state before its time and takes in the later epochs again: the same, bit for
bit, as if it had come in order.
"""

from __future__ import annotations

import threading
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from relnav_graph.arrays import Array
from relnav_graph.core.cautions import Caution
from relnav_graph.core.copies import check_copied, copiers, with_copies
from relnav_graph.core.epochs import Epoch, stamped
from relnav_graph.core.measurement import SAME_TIME, Measurement
from relnav_graph.core.packing import Repeats, held, merged, under, unpack, without_repeats
from relnav_graph.core.problem import Prior, Problem
from relnav_graph.core.state import Layout
from relnav_graph.errors import EstimationError, InputError, LateError, ModelError
from relnav_graph.estimators import GROUP, ServesOnline
from relnav_graph.estimators.online.engine import (
    Engine,
    EngineState,
    Estimate,
    LooksAgain,
    Refusal,
    TakesExtra,
)
from relnav_graph.estimators.online.extras import check_numbers, extras_in, saved_extras
from relnav_graph.estimators.online.monitor import (
    DOWNWEIGHTED,
    REJECTED,
    USED,
    Health,
    Monitor,
    caution,
)
from relnav_graph.estimators.online.refusals import named, refusals
from relnav_graph.estimators.online.state import Moment, Setting, State, known_in
from relnav_graph.estimators.second_look import SECOND_LOOK
from relnav_graph.estimators.source import UNSOLVED
from relnav_graph.linear.assembly import Assembly
from relnav_graph.registry import find_class

__all__ = ["Engine", "EngineState", "Estimate", "Online", "Refusal", "online"]


#: Epochs of the window where the problem gives it no length of time.
DEFAULT_EPOCHS = 30


class Online:
    """An estimator in service; `online` makes one by its kind.

    problem: models, gates, losses, window, and the prior, which holds at the first epoch;
    its own epochs are not used. counts: refused before they were taken in, by sensor and
    reason ("invalid", "late", "duplicate"). For one thread: another one is refused.
    """

    def __init__(self, problem: Problem, kind: str) -> None:
        estimator = find_class(GROUP, kind)()
        if not isinstance(estimator, ServesOnline):
            raise ModelError(f"estimator {kind!r} cannot be driven online: it has no `engine`")
        self.kind = kind
        self.counts: dict[str, dict[str, int]] = {name: {} for name in problem.sensors}
        self._owner: int | None = None
        self._makers = copiers(problem.sensors)
        begun = Setting(estimator, replace(problem, epochs=()))
        self._state = State(begun.engine.begin(), begun, Monitor.of(problem.sensors))

    def from_prior(self, prior: Prior) -> Online:
        """Another one of its kind that begins at a prior."""
        return Online(replace(self.problem, prior=prior), self.kind)

    @property
    def problem(self) -> Problem:
        """Models and prior, with the numbered blocks seen so far, without epochs."""
        return self._state.setting.problem

    @property
    def engine(self) -> Engine:
        """The estimator's engine, of that problem."""
        return self._state.setting.engine

    # --- what it knows ---------------------------------------------------------------------

    @property
    def layout(self) -> Layout:
        """Blocks of the state."""
        return self.problem.layout

    @property
    def t(self) -> float | None:
        """Time of the newest epoch, s; None before the first."""
        t: float | None = self._state.engine.t
        return t

    @property
    def x(self) -> Array:
        """Estimate at the newest epoch (size,)."""
        x: Array = self._state.engine.x
        return x

    @property
    def P(self) -> Array:
        """Its covariance (n, n)."""
        P: Array = self._state.engine.P
        return P

    @property
    def epochs(self) -> tuple[Epoch, ...]:
        """Those of the window, which late measurements may still change."""
        return tuple(m.epoch for m in self._state.moments)

    def health(self, t: float | None = None) -> tuple[Health, str]:
        """OK, DEGRADED or LOST at time t, s (the newest epoch's), and why."""
        now = self.t if t is None else t
        if now is None:
            return "LOST", "no epoch was taken in yet"
        return self._state.monitor.health(now)

    @property
    def totals(self) -> dict[str, dict[str, int]]:
        """Observations by sensor: used, rejected, downweighted, and the counts."""
        names = {"used": USED, "rejected": REJECTED, "downweighted": DOWNWEIGHTED}
        found = {name: self._state.monitor.count(column) for name, column in names.items()}
        return {
            sensor: {name: n[sensor] for name, n in found.items()} | self.counts.get(sensor, {})
            for sensor in self.problem.sensors
        }

    # --- taking in -------------------------------------------------------------------------

    def admit(
        self, sensor: str, t: float, z: Any, ids: Any, t_arrival: float | None = None, R: Any = None
    ) -> Measurement:
        """A measurement, checked against its sensor: known, finite, of its width, with ids
        and values that it can have. Raises InputError, and counts it as invalid."""
        try:
            if sensor not in self.problem.sensors:
                known = ", ".join(self.problem.sensors)
                raise InputError(f"unknown sensor {sensor!r}, expected one of: {known}")
            m = Measurement(sensor, t, z, ids, t_arrival, covariance=R)
            # Assembled alone: all that the sensor's model has to say against it.
            self._state.setting.seeing((m,)).models.again(Epoch(m.t, (m,)), None)
        except (InputError, TypeError, ValueError) as error:
            self._count(sensor, "invalid")
            if isinstance(error, InputError):
                raise
            raise InputError(f"sensor {sensor!r} at t = {t} s: {error}") from error
        return m

    def step(self, epoch: Epoch, assembly: Assembly | None = None) -> Estimate:
        """Take in an epoch that is not before the newest one; the estimate there.

        One of the same time is merged with it. assembly: of this epoch, where the caller has
        it already. Raises LateError when it is before the newest (see `insert`), InputError
        when it is not in order, ModelError when a model breaks its contract,
        EstimationError when there is no estimate; all is then as before.
        """
        self._claim()
        t = self.t
        merge = self.problem.merge
        if t is not None and epoch.t <= t + merge:
            if epoch.t < t - merge:
                raise LateError(f"epoch at {epoch.t} s: before the newest one, at {t} s")
            return self.insert(epoch.measurements)
        if not np.isfinite(epoch.t):
            raise InputError(f"epoch: found t = {epoch.t} s, expected a finite time")
        if any(SAME_TIME < abs(m.t - epoch.t) <= merge for m in epoch.measurements):
            own = (stamped(m, epoch.t) for m in epoch.measurements)
            epoch = replace(epoch, measurements=tuple(own))
        kept, repeats = without_repeats(with_copies(epoch, self._makers, merge))
        assembly = assembly if kept is epoch else None
        state, found = self._advance(self._state, kept, assembly)
        return self._swap(state, repeats, found)

    def insert(self, measurements: Sequence[Measurement]) -> Estimate:
        """Take in late measurements: the newest estimate, as if they had come in order.

        A time between two epochs makes a new one. Raises LateError, and counts it, on one
        before the window, InputError on one after the newest epoch; as `step` does
        otherwise. All is then as before.
        """
        self._claim()
        if not measurements:
            return self._swap(self._state, [], ())
        old, merge = self._state, self.problem.merge
        for m in measurements:
            self._check_late(m)
        first = min(m.t for m in measurements) - merge
        start = next(i for i, moment in enumerate(old.moments) if moment.epoch.t >= first)
        epochs = [moment.epoch for moment in old.moments[start:]]
        for m in measurements:
            epochs = merged(epochs, m, self.problem.processes, merge)
        cleaned = [without_repeats(e) for e in epochs]
        repeats = [r for _, more in cleaned for r in more]
        if sum(len(ids) for _, _, ids in repeats) == sum(len(m.z) for m in measurements):
            return self._swap(old, repeats, ())  # nothing new in them
        moment = old.moments[start]
        if old.added:
            check_numbers(self.engine, old, start, [epoch.t for epoch, _ in cleaned])
        before = tuple(one for one in old.added if one[0] < moment.epoch.t)
        state = State(
            *(moment.state, moment.setting, moment.monitor, old.moments[:start], old.past),
            *(before, moment.turned),
        )
        found: tuple[Refusal, ...] = ()
        for epoch, _ in cleaned:
            state, more = self._advance(state, epoch)
            state = self._added(state, old.added, epoch.t)
            found += more
        return self._swap(state, repeats, found)

    def add(self, extra: Any) -> None:
        """Put native factors and variables of a graph (`relnav_graph.estimators.isam2.Extra`) to
        an estimator that has one; epochs are numbered as they come, from 0 on.

        What names epochs to come waits for them. Raises InputError when the estimator takes none,
        or they do not fit, EstimationError when they leave a variable undetermined; all is then as
        before.
        """
        self._claim()
        if not isinstance(self.engine, TakesExtra):
            raise InputError(f"estimator {self.kind!r} takes no extra factors; isam2 does")
        t = -np.inf if self.t is None else self.t
        self._state = self._added(self._state, ((t, extra),), t)

    @property
    def variables(self) -> Mapping[int, tuple[Any, Array]]:
        """Value and covariance (d, d) of each variable that `add` has brought, by its key."""
        engine = self.engine
        return engine.variables(self._state.engine) if isinstance(engine, TakesExtra) else {}

    def second_look(self) -> tuple[Caution, ...]:
        """A caution where the whole pass, smoothed, is not as its covariances say: of an estimator
        that holds it, OK at the newest epoch; else none. Changes nothing; takes one to two times as
        long as a batch estimate of all epochs so far, after one such estimate."""
        engine = self.engine
        if not isinstance(engine, LooksAgain) or self.health()[0] != "OK":
            return ()
        try:
            return engine.second_look(self._state.engine)
        except UNSOLVED as error:
            return (Caution(SECOND_LOOK, f"no second look could be taken: {error}"),)

    def predict(self, t: float, inputs: Mapping[str, Array] | None = None) -> tuple[Array, Array]:
        """x (size,) and P (n, n) ahead at time t, s; changes nothing.

        inputs: of each process, since the newest epoch; without, the newest ones go on.
        Raises InputError on a time before the newest epoch, GeometryError or
        EstimationError when the state cannot be propagated.
        """
        now = self.t
        if now is None or not np.isfinite(t) or t < now - SAME_TIME:
            raise InputError(f"predict: found t = {t} s, expected one from {now} s on")
        if t <= now + SAME_TIME:
            return self.x, self.P
        if inputs is None:
            inputs = held(self.epochs[-1].inputs, self.problem.processes, t - now)
        ahead = Epoch(t, (), inputs)
        with named(ahead):
            x, P = self._state.setting.models.again(ahead, now).predict(self.x, self.P)
        if not (np.isfinite(x).all() and np.isfinite(P).all()):
            raise EstimationError(f"predict: the state at {t} s is not finite")
        return x, P

    # --- as plain arrays -------------------------------------------------------------------

    def state(self) -> dict[str, Array]:
        """All that it knows, as plain arrays by name, for `restore`.

        The oldest state of the window and the epochs since; all epochs for an engine whose
        state cannot be saved. Raises InputError on an extra factor that cannot be saved.
        """
        extras = saved_extras(self._state.added)
        return self._state.saved(self.counts) | {f"extra.{name}": a for name, a in extras.items()}

    def restore(self, state: Mapping[str, Array]) -> None:
        """Be what gave `state`: later estimates are the same, bit for bit, on the same
        platform. Raises InputError unless it has taken in nothing yet."""
        self._claim()
        if self._state.moments:
            raise InputError("restore: expected an estimator that has taken in nothing yet")
        own = under(state, "engine.")
        setting = self._state.setting.knowing(known_in(state, self.problem))
        engine = setting.engine.load(own) if own else setting.engine.begin()
        monitor = Monitor.of(self.problem.sensors, np.array(state["monitor"]))
        new = State(engine, setting, monitor, turned=float(state.get("turned", 0.0)))
        extras = extras_in(self.engine, under(state, "extra."))
        new = self._added(new, extras, -np.inf)
        for epoch in unpack(under(state, "epochs.")):
            new, _ = self._advance(new, epoch)
            new = self._added(new, extras, epoch.t)
        counts: dict[str, dict[str, int]] = {name: {} for name in self.problem.sensors}
        for key, n in under(state, "counts.").items():
            reason, _, sensor = key.partition(".")
            if sensor in counts:
                counts[sensor][reason] = int(n)
        self.counts, self._state = counts, new

    # --- inside ----------------------------------------------------------------------------

    def release(self) -> None:
        """Let another thread go on: for who lets in one at a time, by a lock of its own."""
        self._owner = None

    def _claim(self) -> None:
        """Raise EstimationError in a thread that is not the first one to use it."""
        here = threading.get_ident()
        self._owner = here if self._owner is None else self._owner
        if self._owner != here:
            raise EstimationError("an estimator serves one thread: make one for each")

    def _count(self, sensor: str, reason: str, n: int = 1) -> None:
        if sensor in self.counts:  # names that no sensor has would take memory without end
            counts = self.counts[sensor]
            counts[reason] = counts.get(reason, 0) + n

    def _added(self, s: State, extras: Sequence[tuple[float, Any]], t: float) -> State:
        """The state with those extras that were added when the newest epoch was at t, s."""
        for extra in (extra for at, extra in extras if at == t):
            engine: Any = s.setting.engine
            s = replace(s, engine=engine.add(s.engine, extra), added=(*s.added, (t, extra)))
        return s

    def _check_late(self, m: Measurement) -> None:
        where = f"sensor {m.sensor!r} at t = {m.t} s"
        if m.sensor not in self.problem.sensors:
            raise InputError(f"{where}: unknown sensor")
        if self.t is None or m.t > self.t + self.problem.merge:
            raise InputError(f"{where}: after the newest epoch, at {self.t} s; expected a late one")
        begin = self._state.moments[0].epoch.t
        if m.t < begin - self.problem.merge:
            self._count(m.sensor, "late", len(m.z))
            raise LateError(f"{where}: has left the window, which begins at {begin} s")

    def _advance(
        self, s: State, epoch: Epoch, assembly: Assembly | None = None
    ) -> tuple[State, tuple[Refusal, ...]]:
        """The state with one more epoch, and what was refused of it."""
        if self._makers:
            check_copied(epoch.measurements, self.problem.sensors, s.monitor.count(USED))
        setting = s.setting.seeing(epoch.measurements)
        with named(epoch):
            before = setting.taken(s.engine, s.setting)
            if assembly is None or setting is not s.setting:
                assembly = setting.models.again(epoch, s.engine.t)
            engine = setting.engine.advance(before, epoch, assembly)
        monitor = s.monitor.after(epoch.t, engine.done)
        moment = Moment(s.engine, s.setting, s.monitor, epoch, s.turned)
        moments, past = (*s.moments, moment), s.past
        length = self.problem.window
        gone = len(moments) - DEFAULT_EPOCHS
        if length is not None:
            begin = epoch.t - length - SAME_TIME
            gone = next(i for i, m in enumerate(moments) if m.epoch.t >= begin)
        if gone > 0:
            if not self.engine.compact:
                for m in moments[:gone]:
                    past = (m.epoch, past)
            moments = moments[gone:]
        turned_by = s.turned + setting.turned(s.engine, engine)
        after = State(engine, setting, monitor, moments, past, s.added, turned_by)
        return after, refusals(epoch.t, engine.done)

    def _swap(self, state: State, repeats: Repeats, found: tuple[Refusal, ...]) -> Estimate:
        refused = (*(Refusal(*r, "duplicate") for r in repeats), *found)
        t = state.engine.t
        if t is None:
            raise InputError("no epoch was taken in yet")
        status, message = state.monitor.health(t)
        doubt = caution(state.setting.problem, state.moments[-1].epoch, state.engine.x)
        begins = state.setting.initialising(state.turned)
        if begins and status == "OK":
            status, message = "INITIALISING", begins
        if doubt:
            status = "DEGRADED" if status != "LOST" else status
            message = "; ".join(filter(None, [message, doubt]))
        estimate = Estimate(t, state.engine.x, state.engine.P, status, message, refused)
        self._state = state  # the one assignment that makes it so
        for sensor, _, ids in repeats:
            self._count(sensor, "duplicate", len(ids))
        return estimate


def online(kind: str, problem: Problem) -> Online:
    """An estimator of a kind, to be driven online; epochs of the problem are ignored. Raises
    ModelError when there is none of that kind, or it has no ``engine``."""
    return Online(problem, kind)
