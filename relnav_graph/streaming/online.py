"""An estimator in service, fed with arrays as they come, from any thread; see `Online`."""

from __future__ import annotations

import threading
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from relnav_graph.arrays import Array
from relnav_graph.core.cautions import Caution
from relnav_graph.core.measurement import SAME_TIME, Measurement
from relnav_graph.core.models import derived_quantities
from relnav_graph.core.numbered import numbered_of
from relnav_graph.core.problem import Problem
from relnav_graph.core.shown import Shown
from relnav_graph.core.stamps import first_stamp, seconds
from relnav_graph.core.state import Layout
from relnav_graph.core.track import Track
from relnav_graph.core.track import estimates as parts_of
from relnav_graph.errors import InputError
from relnav_graph.estimators.online.driver import online
from relnav_graph.scoring.deviations import StateEstimates, estimates
from relnav_graph.streaming.lines import Header, InputSample, Tick
from relnav_graph.streaming.options import Options, Parsed
from relnav_graph.streaming.session import Session

__all__ = ["Online", "OnlineEstimate"]


@dataclass(frozen=True, eq=False, repr=False)
class OnlineEstimate(Shown):
    """What is known at one time: t, s; status, "OK", "INITIALISING", "DEGRADED" or "LOST", and why;
    x (size,) and P (n, n) of the blocks of a layout. rejected: what was not used since the estimate
    before, as dicts of sensor, t, id and reason; cautions: see `Track`."""

    t: float
    status: str
    message: str
    layout: Layout
    x: Array
    P: Array
    rejected: tuple[Mapping[str, Any], ...] = ()
    cautions: tuple[Mapping[str, str], ...] = ()

    @cached_property
    def states(self) -> dict[str, StateEstimates]:
        """Each block, and what is derived of them (relative attitude, position in the target's
        frame), by name; arrays with one row."""
        t, parts = np.array([self.t]), parts_of(self.layout, self.x[None], self.P[None])
        found = estimates(
            Track("online", "filtered", t=t, **parts), derived_quantities(self.layout)
        )
        for block in self.layout:  # points of a map
            rows = self.layout.tangent(block.name)
            value, P = self.layout.value(self.x, block.name), self.P[rows, rows]
            found.setdefault(block.name, StateEstimates(block, value[None], P[None]))
        return found

    def value(self, name: str) -> Array:
        """Value of a block or derived quantity, (3, 3) or (dim,), SI."""
        value: Array = self._state(name).value[0]
        return value

    def covariance(self, name: str) -> Array:
        """Its covariance (dim, dim), SI, of an attitude about the axes of its right-hand frame."""
        P: Array = self._state(name).P[0]
        return P

    def sigma(self, name: str) -> Array:
        """Its sigmas (dim,), SI."""
        return np.sqrt(np.diag(self.covariance(name)))

    def _state(self, name: str) -> StateEstimates:
        if name not in self.states:
            raise InputError(f"found {name!r}, expected one of: {', '.join(self.states)}")
        return self.states[name]

    def _shown(self) -> tuple[str, Mapping[str, str]]:
        said = f": {self.message}" if self.message else ""
        rows = {}
        for name, state in list(self.states.items())[:8]:
            scale, unit = state.block.table_scale, state.block.table_unit
            sigma = scale * np.sqrt(np.trace(state.P[0]))
            rows[name] = f"{state.block.symbol}, 1-sigma {sigma:.3g} {unit}"
        return f"Estimate at {self.t:.9g} s, {self.status}{said}", rows


class _Session(Session):
    """A stream whose estimates stay arrays."""

    def _object(self, x: Array, P: Array) -> Any:
        return self.online.layout, x, P


class Online:
    """An estimator in service, for a loop, or for the callbacks of a middleware.

    ::

        online = rg.Online(problem, "fixed_lag")
        online.push_input("gyro", t0, t1, rate)   # means over [t0, t1], in any order
        online.push("camera", t, z, ids)          # in any order, late ones too
        estimate = online.estimate()              # the newest, or None
        estimate.value("relative_position"), estimate.sigma("relative_position")

    It is `relnav stream` without the text, with the same rules (`relnav_graph.streaming.lines`):
    measurements wait for the inputs up to their time; late ones are put where they belong, as long
    as the window (or 30 epochs) holds their time; what comes too late, twice, or by another clock
    is refused, counted in `rejected`, and told by the next estimate. Gaps in inputs are bridged
    after `patience`.

    Every method may be called from any thread: a lock of its own lets in one at a time, for as long
    as an update takes. Where several threads feed it, the estimate is that of one thread that
    feeds the same, whatever the order, as long as none is late by more than the window.

    problem: its epochs are not used; kind: of an estimator that runs online. t: time of the prior,
    by default that of the first epoch. Stamps are seconds as floats, or whole nanoseconds or
    datetime64, of which `origin`, by default the first stamp pushed, is subtracted in whole
    numbers: estimates count seconds from there. measured: blocks whose prior is to be made of the
    first measurements. patience: how long, s, to wait for an input before a gap in it is bridged,
    by default the window, or 30 s; max_gap: s, a stamp further than this from the newest one is of
    another clock. Raises ModelError on an estimator that does not run online.
    """

    def __init__(
        self,
        problem: Problem,
        kind: str = "fixed_lag",
        *,
        t: Any = None,
        origin: Any = None,
        measured: Sequence[str] = (),
        patience: float | None = None,
        max_gap: float = 3600.0,
    ) -> None:
        self._lock, self._origin = threading.RLock(), origin
        self._whole: bool | None = None  # whether stamps are whole numbers, as the first one is
        if origin is None and t is not None:
            self._origin = first_stamp([("t", t)])
        begin = None if t is None else float(seconds("t", t, self._origin)[0])
        options = Options(max_gap=max_gap, patience=patience)
        driver, header = online(kind, problem), Header(t=begin)
        self._session = _Session(driver.problem, driver, header, options, measured)
        self._lags = {name: stamps.lag for name, stamps in problem.stamps.items()}
        self._newest: OnlineEstimate | None = None

    @contextmanager
    def _mine(self) -> Iterator[_Session]:
        """The session, for this thread alone."""
        with self._lock:
            try:
                yield self._session
            finally:
                self._session.online.release()

    # --- in --------------------------------------------------------------------------------

    def push(
        self, sensor: str, t: Any, z: Any, ids: Any = None, t_arrival: Any = None
    ) -> list[OnlineEstimate]:
        """Take in what a sensor measured at time t; the estimates that became possible by it.

        z (k, columns), or (columns,) for one observation, in the units that the sensor's `columns`
        name; ids (k,), which may be left out where the sensor sees one thing. t_arrival: when it
        became known, by the same clock. Raises InputError on an unknown sensor or values that it
        cannot give; all is then as before.
        """
        with self._mine() as session:
            sensors = session.problem.sensors
            if sensor not in sensors:
                known = ", ".join(sensors)
                raise InputError(f"unknown sensor {sensor!r}, expected one of: {known}")
            rows, model = np.atleast_2d(np.asarray(z)), sensors[sensor]
            if ids is None:
                single = numbered_of(model) is None and len(model.observables()) == 1
                if not single or len(rows) != 1:
                    raise InputError(f"sensor {sensor!r}: found no ids for {len(rows)} rows")
                ids = model.observables()
            if rows.ndim != 2 or rows.shape[1] != len(model.columns):
                found = f"found z of {np.shape(z)}, expected columns {', '.join(model.columns)}"
                raise InputError(f"sensor {sensor!r}: {found}")
            at = self._seconds("t", t) - self._lags.get(sensor, 0.0)
            arrival = None if t_arrival is None else self._seconds("t_arrival", t_arrival)
            m = Measurement(sensor, at, rows, np.atleast_1d(np.asarray(ids)), arrival)
            model.accept(m.z)
            model.observation_data(m.ids)
            return self._take(m)

    def push_input(self, name: str, t_start: Any, t_end: Any, values: Any) -> list[OnlineEstimate]:
        """Take in means of an input over [t_start, t_end]: values (channels,), or (n, channels) for
        n intervals with t_start and t_end (n,); the estimates that became possible by it.

        Raises InputError on an unknown input or values that are none of it; all is then as before.
        """
        with self._mine() as session:
            columns = session.columns
            if name not in columns:
                known = ", ".join(columns) or "none"
                raise InputError(f"unknown input {name!r}, expected one of: {known}")
            start, end = (np.atleast_1d(np.asarray(t)) for t in (t_start, t_end))
            rows = np.asarray(values)
            if rows.dtype.kind not in "fiu":
                raise InputError(f"input {name!r}: found {rows.dtype}, expected real numbers")
            rows = rows.astype(np.float64)
            rows = rows[None] if rows.ndim == 1 and len(start) == 1 else rows
            wanted = (len(start), len(columns[name]))
            if start.shape != end.shape or rows.shape != wanted or not np.isfinite(rows).all():
                found = f"found values {np.shape(values)} over {start.shape} and {end.shape}"
                raise InputError(f"input {name!r}: {found}, expected finite numbers {wanted}")
            lag, made = self._lags.get(name, 0.0), list[InputSample]()
            for a, b, v in zip(start, end, rows, strict=True):
                t0, t1 = self._seconds("t_start", a) - lag, self._seconds("t_end", b) - lag
                if t1 - t0 <= SAME_TIME:
                    raise InputError(
                        f"input {name!r}: found {a} to {b}, expected times that run on"
                    )
                made.append(InputSample(name, t0, t1, v))
            return [estimate for sample in made for estimate in self._take(sample)]

    def push_epoch(self, t: Any) -> list[OnlineEstimate]:
        """Ask for an estimate at time t, at which nothing may be measured."""
        with self._mine():
            return self._take(Tick(self._seconds("t", t)))

    # --- out -------------------------------------------------------------------------------

    def estimate(self) -> OnlineEstimate | None:
        """The newest estimate, with all in it that has arrived and that inputs reach; None before
        the first. One whose status is LOST has no number that is to be used."""
        with self._mine() as session:
            self._found(session.pause())
            return self._newest

    def predict(self, t: Any) -> OnlineEstimate:
        """The newest estimate, propagated to time t, the newest inputs held where they end. Changes
        nothing. Raises InputError before the first estimate, or at a time before it."""
        with self._mine() as session:
            self._found(session.pause())
            if self._newest is None or session.online.t is None:
                raise InputError("predict: there is no estimate yet")
            at = self._seconds("t", t)
            x, P = session.ahead(at)
            said = self._newest.status, self._newest.message
            return OnlineEstimate(at, *said, session.online.layout, x, P)

    @property
    def rejected(self) -> dict[str, dict[str, int]]:
        """How much was not used, by sensor or input and kind of reason."""
        with self._mine() as session:
            return {name: dict(counts) for name, counts in session.rejected.items()}

    @property
    def used(self) -> dict[str, int]:
        """How many observations were used, by sensor."""
        with self._mine() as session:
            return {name: n["used"] for name, n in session.online.totals.items()}

    def second_look(self) -> tuple[Caution, ...]:
        """What a second look at the whole pass says; see `relnav_graph.estimators.second_look`."""
        with self._mine() as session:
            return session.online.second_look()

    # --- inside ----------------------------------------------------------------------------

    def _seconds(self, where: str, t: Any) -> float:
        """A stamp as seconds of the pass. Raises InputError on one of another kind than the first:
        21 is 21 ns, 21.0 are seconds."""
        if self._origin is None:
            self._origin = first_stamp([(where, t)])
        at = float(seconds(where, t, self._origin)[0])
        whole = np.asarray(t).dtype.kind != "f"
        self._whole = whole if self._whole is None else self._whole
        if whole != self._whole:
            kinds = "seconds as floats", "whole nanoseconds or datetime64"
            raise InputError(f"{where}: found {t!r}, expected {kinds[self._whole]}, as before")
        if not np.isfinite(at):
            raise InputError(f"{where}: found {t}, expected a finite time")
        return at

    def _take(self, item: Measurement | InputSample | Tick) -> list[OnlineEstimate]:
        return self._found(self._session.take(Parsed(None, item)))

    def _found(self, lines: Sequence[Mapping[str, Any]]) -> list[OnlineEstimate]:
        """Lines out as estimates, the newest of which is kept."""
        found = []
        for line in lines:
            if line["estimate"] is None:
                if self._newest is None or line["t"] is None:
                    continue  # nothing to tell it with: `rejected` counts it
                layout, x, P = self._newest.layout, self._newest.x, self._newest.P
                layout, x, P = layout, np.full_like(x, np.nan), np.full_like(P, np.nan)
            else:
                layout, x, P = line["estimate"]
            told = tuple(line["rejected"]), tuple(line.get("cautions", ()))
            said = float(line["t"]), line["status"], line["message"]
            found.append(OnlineEstimate(*said, layout, x, P, *told))
        self._newest = found[-1] if found else self._newest
        return found
