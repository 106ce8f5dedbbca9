"""One stream from its first line to its last: when a line is processed, and what is answered.

Lines come in any order. Measurements wait until the inputs reach their time and until
something has arrived after them, so that all that arrives at one moment is one update; then
their epochs are estimated in order of the time of validity. A measurement that comes after a
newer epoch is inserted at its own time, as long as the estimator's window holds that time.

The state of a session depends on its lines and on the pauses between them alone: on no clock
and no random number. So a journal of lines and pauses is enough to replay it.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from relnav_graph.arrays import Array
from relnav_graph.core.cautions import Caution
from relnav_graph.core.copies import uncopied
from relnav_graph.core.epochs import Epoch
from relnav_graph.core.measurement import SAME_TIME, Measurement
from relnav_graph.core.models import derived_quantities
from relnav_graph.core.packing import under
from relnav_graph.core.problem import Prior, Problem
from relnav_graph.errors import InputError, RelnavError
from relnav_graph.estimators.online.driver import Estimate, Online
from relnav_graph.streaming import saved
from relnav_graph.streaming.beginning import Beginning
from relnav_graph.streaming.buffers import WaitingEpoch
from relnav_graph.streaming.doubts import Doubts
from relnav_graph.streaming.intake import Intake, Item, name_of, times_of
from relnav_graph.streaming.lines import (
    Header,
    LineError,
    Tick,
    parse_line,
)
from relnav_graph.streaming.options import PATIENCE, Options, Parsed
from relnav_graph.streaming.refusals import Refusals
from relnav_graph.streaming.right_units import check_inputs, misfits
from relnav_graph.streaming.writing import estimate_object

__all__ = ["Options", "Parsed", "Session"]

LineOut = dict[str, Any]


class Session:
    """An online estimator fed with lines.

    online: the estimator, which has taken in nothing yet; header: of the stream; measured:
    blocks whose prior is to be taken from the first epochs; origin: s, taken off the times of
    lines.
    """

    def __init__(
        self,
        problem: Problem,
        online: Online,
        header: Header,
        options: Options,
        measured: Sequence[str] = (),
        origin: float = 0.0,
    ) -> None:
        self.problem, self.online, self.header, self.options = problem, online, header, options
        self.columns = {k: v for p in problem.processes.values() for k, v in p.inputs.items()}
        self.seq = 0
        self.status = "LOST"
        self.lines = self.refused = 0
        self._origin, self._lags = origin, {n: s.lag for n, s in problem.stamps.items()}
        self._patience = options.patience or problem.window or PATIENCE
        self._refusals = Refusals((*problem.sensors, *self.columns))
        self._intake = Intake(
            *(tuple(problem.sensors), self.columns, options.max_gap, self._patience),
            *(header.t, problem.merge),
        )
        self._clock, self._waiting = self._intake.clock, self._intake.waiting
        self._inputs = self._intake.inputs
        self._derived = derived_quantities(problem.layout)
        self._last = -1  # number `n` of the last line that was taken in
        self._fits: set[str] = set()  # sensors whose unit was checked and is right
        self._doubts = Doubts(problem, self._patience)
        self._beginning = Beginning(problem, measured) if measured else None

    @property
    def cautions(self) -> tuple[Caution, ...]:
        """What leaves the status as it is, and must be known all the same."""
        return self._doubts.cautions

    @property
    def rejected(self) -> dict[str, dict[str, int]]:
        """How much was not used, by sensor or input and kind of reason."""
        return self._refusals.counts

    # --- lines in ------------------------------------------------------------------------

    def parse(self, raw: bytes) -> Parsed:
        """The content of a line, checked; changes no state."""
        try:
            off = self._origin, self._lags
            return Parsed(*parse_line(raw, self.problem.sensors, self.columns, *off))
        except LineError as error:
            return Parsed(None, error)

    def repeats(self, line: Parsed) -> bool:
        """Whether a line is a repetition, by the sender, of an earlier one: by its number, unless
        its time is new, as when a sender has begun to count anew."""
        if line.n is None or line.n > self._last:
            return False
        if isinstance(line.item, Header | LineError):
            return True
        return not self._clock.follows(times_of(line.item)[-1])

    def take(self, line: Parsed) -> list[LineOut]:
        """Process a line in; the lines out that result.

        One that is refused leaves all as it was: but for what counts and tells refusals.
        """
        self.lines += 1
        item = line.item
        if isinstance(item, LineError):
            self.refused += 1
            self._reject(item.sensor, item.t, None, item.reason)
            return []
        if isinstance(item, Header):
            if self.lines > 1:
                self.refused += 1
                self._reject(None, None, None, "header: found one after the first line")
                return []
            said = []
        else:
            try:
                leap = self._intake.take(item, self._epochs, self.online.t)
            except InputError as error:
                return self._refuse_line(item, error)
            said = [self._say(leap)] if leap else []
        self._last = self._last if line.n is None else line.n
        return said + self._advance(everything=False)

    def pause(self) -> list[LineOut]:
        """The lines out at a pause: the newest epoch need not wait for a later arrival."""
        return self._advance(everything=True)

    @property
    def busy(self) -> bool:
        """Whether epochs wait, so that a pause could give lines out."""
        return bool(self._waiting.epochs)

    def end(self) -> list[LineOut]:
        """The end of the stream, and of what still waits; the last line, if any is due."""
        out = self._advance(everything=True, ended=True)
        if self._beginning is not None and self._beginning.epochs:
            out += self._begun()
        looked = self.status == "OK" and self._doubts.look(self.online.second_look())
        if self._refusals.notes or looked:
            out.append(self._line(self.online.t, self.status, "the end of the stream", None))
        return out

    def _reject(self, sensor: str | None, t: float | None, id: int | None, reason: str) -> None:
        self._refusals.add(sensor, t, id, reason)

    def _refuse(self, epoch: WaitingEpoch, reason: str) -> None:
        for m in epoch.measurements:
            for i in m.ids.tolist():
                self._reject(m.sensor, m.t, i, reason)

    def _refuse_line(self, item: Item, error: InputError) -> list[LineOut]:
        """Refuse a line as it comes; a line out at once when it tells that a clock is wrong."""
        self.refused += 1
        name = None if isinstance(item, Tick) else name_of(item)
        for i in item.ids.tolist() if isinstance(item, Measurement) else [None]:
            self._reject(name, times_of(item)[-2], i, str(error))
        wrong = self._intake.refuse(item, self._epochs, error)
        return [self._say(wrong)] if wrong else []

    def _say(self, message: str) -> LineOut:
        """A line out that warns of something, with the newest estimate, if there is one."""
        t = self.online.t
        known = None if t is None else (self.online.x, self.online.P)
        return self._line(t, "LOST" if known is None else "DEGRADED", message, known)

    # --- epochs --------------------------------------------------------------------------

    @property
    def _epochs(self) -> Sequence[Epoch]:
        """Those that a late measurement may still change."""
        return self.online.epochs if self._beginning is None else self._beginning.epochs

    @property
    def _reached(self) -> float | None:
        """Time of the newest epoch estimated, or held back before the first estimate, s."""
        return self.online.t if self._beginning is None else self._beginning.t

    def _advance(self, everything: bool, ended: bool = False) -> list[LineOut]:
        """Take in the epochs that are complete, in order of time; in the end, all of them."""
        out = []
        while self._waiting.epochs:
            epoch = self._waiting.epochs[0]
            if not everything and epoch.arrival >= self._clock.heard - SAME_TIME:
                break
            now = self._reached
            if now is not None and epoch.t > now and self._lacking(epoch.t):
                if self._clock.heard - epoch.t <= self._patience and not ended:
                    break
                refusal = self._bridge(now, epoch.t)
                if refusal:
                    self._refuse(self._waiting.epochs.pop(0), refusal)
                    out.append(self._line(epoch.t, "LOST", refusal, None))
                    continue
            self._waiting.epochs.pop(0)
            out += self._estimate(epoch)
        return out

    def _lacking(self, t: float) -> str:
        """Which input does not reach t, s; "" when all do."""
        now = self._reached
        return "" if now is None else self._inputs.lacking(now, t)

    def _bridge(self, now: float, t: float) -> str:
        """Say which gaps in inputs are bridged from `now` to t, s; or why they cannot be."""
        try:
            gaps = self._inputs.gaps(self.problem, now, t)
        except InputError as error:
            return f"no inputs: {error}"
        for gap in gaps:
            self._reject(gap.name, gap.end, None, self._doubts.bridged(gap, now))
        return ""

    def _since(self, now: float, t: float, hold: bool = False) -> dict[str, Array]:
        """Inputs of each process from the newest epoch on to t."""
        return self._inputs.since(self.problem, now, t, hold)

    def _begin(self, epoch: WaitingEpoch, beginning: Beginning) -> list[LineOut]:
        """Process an epoch before there is an estimate."""
        now = beginning.t
        try:
            inputs = {} if now is None or epoch.t <= now else self._since(now, epoch.t)
            enough = beginning.take(Epoch(epoch.t, tuple(epoch.measurements), inputs))
        except (RelnavError, np.linalg.LinAlgError) as error:
            self._refuse(epoch, str(error))
            return [self._line(epoch.t, "LOST", str(error), None)]
        return self._begun() if enough else []

    def _begun(self) -> list[LineOut]:
        """Make the prior from the epochs that were held back, and estimate them from it."""
        assert self._beginning is not None
        held, (prior, self._doubts.prior) = self._beginning.epochs, self._beginning.prior()
        self._beginning, self.online = None, self.online.from_prior(prior)
        self.problem = self.online.problem
        out = list[LineOut]()
        for e in held:
            out += self._estimate(WaitingEpoch(e.t, e.t, list(e.measurements)))
        return out

    @property
    def _used(self) -> dict[str, int]:
        """How many observations of each sensor were used."""
        return {name: n["used"] for name, n in self.online.totals.items()}

    def _estimate(self, epoch: WaitingEpoch) -> list[LineOut]:
        if self._beginning is not None:
            return self._begin(epoch, self._beginning)
        now, measurements = self.online.t, tuple(epoch.measurements)
        try:
            if now is not None and epoch.t <= now + self.problem.merge:
                found = self.online.insert(measurements) if measurements else None
            else:
                inputs = {} if now is None else self._since(now, epoch.t)
                first = self.online, self._fits, measurements, epoch.t, inputs
                check_inputs(*first)
                lacking = uncopied(measurements, self.problem.sensors, self._used)
                for m, reason in [*lacking, *misfits(*first)]:
                    self._refuse(WaitingEpoch(m.t, m.t, [m]), reason)
                    measurements = tuple(other for other in measurements if other is not m)
                found = self.online.step(Epoch(epoch.t, measurements, inputs))
        except (RelnavError, np.linalg.LinAlgError) as error:
            self._refuse(epoch, f"failed: {error}")
            return [self._without(epoch.t, str(error))]
        if found is None:
            return []
        for refusal in found.refused:
            for i in refusal.ids:
                self._reject(refusal.sensor, refusal.t, i, refusal.reason)
        for buffer in self._inputs.values():
            buffer.drop(found.t)
        return [self._found(found)]

    # --- lines out -----------------------------------------------------------------------

    def _found(self, found: Estimate) -> LineOut:
        status, message = self._doubts.judge(found.t, found.status, found.message)
        return self._line(found.t, status, message, (found.x, found.P))

    def _without(self, t: float, reason: str) -> LineOut:
        """The line out of an epoch whose update failed: the newest estimate, or the prediction
        from it."""
        now = self.online.t
        if now is None:
            return self._line(t, "LOST", reason, None)
        t = max(t, now)
        status = self.online.health(t)[0]
        status = "LOST" if status == "LOST" else "DEGRADED"
        try:
            inputs = {} if t <= now + SAME_TIME else self._since(now, t)
            return self._line(t, status, reason, self.online.predict(t, inputs))
        except (RelnavError, np.linalg.LinAlgError):
            return self._line(t, "LOST", reason, None)

    def _line(
        self, t: float | None, status: str, message: str, found: tuple[Array, Array] | None
    ) -> LineOut:
        self.status = status
        self._doubts.begin(t)
        line: LineOut = {"seq": self.seq, "t": t, "status": status, "message": message}
        if self.cautions:
            line["cautions"] = [vars(c) for c in self.cautions]
        line["estimate"] = None if found is None else self._object(*found)
        if self.options.predict_to_now and found is not None and t is not None:
            line["now"] = self._now(t, found)
        line["rejected"] = self._refusals.told()
        self.seq += 1
        return line

    def _object(self, x: Array, P: Array) -> Any:
        return estimate_object(self.online.layout, self._derived, x, P)

    def _now(self, t: float, found: tuple[Array, Array]) -> dict[str, Any]:
        """The prediction to the newest time of arrival; inputs are held beyond their end."""
        newest, now = self.online.t, self._clock.heard
        if newest is None or t != newest or now <= t + SAME_TIME:
            return {"t": t, "estimate": self._object(*found)}
        try:
            return {"t": now, "estimate": self._object(*self.ahead(now))}
        except (RelnavError, np.linalg.LinAlgError) as error:
            return {"t": now, "estimate": None, "message": str(error)}

    def ahead(self, t: float) -> tuple[Array, Array]:
        """x (size,) and P (n, n) at time t, s, from the newest epoch on, inputs held beyond their
        end. Raises InputError before it, EstimationError where it cannot be propagated."""
        now = self.online.t
        assert now is not None
        inputs = {} if t <= now + SAME_TIME else self._since(now, t, hold=True)
        return self.online.predict(t, inputs)

    # --- as bytes --------------------------------------------------------------------------

    def save(self) -> bytes:
        """All of its state as bytes."""
        own = {
            "header": saved.header_object(self.header),
            "rejected": self._refusals.counts,
            "refused": self.refused,
            "seq": self.seq,
            "status": self.status,
            "lines": self.lines,
            "clock": self._clock.save(),
            "last": self._last,
            "notes": self._refusals.notes,
            "fits": sorted(self._fits),
            "doubts": self._doubts.save(),
            "inputs": {name: saved.samples(b.samples) for name, b in self._inputs.items()},
            "waiting": saved.waiting(self._waiting.epochs),
        }
        prior, b = self.problem.prior, self._beginning
        own["begun"] = b is None
        first = {"x": prior.x, "P": prior.P} if b is None else b.save()
        arrays = {f"beginning.{name}": array for name, array in first.items()}
        return saved.pack(own, {**self.online.state(), **arrays})

    def load(self, data: bytes) -> None:
        """Restore the session that `save` made `data` of; only before anything was taken in."""
        own, arrays = saved.unpack(data)
        first = under(arrays, "beginning.")
        if not own["begun"] and self._beginning is not None:
            self._beginning.load(first)
        elif self._beginning is not None:
            self.online = self.online.from_prior(Prior(first["x"], first["P"]))
            self._beginning, self.problem = None, self.online.problem
        self._doubts.load(own["doubts"])
        self.online.restore(arrays)
        self._refusals.counts, self._refusals.notes = own["rejected"], own["notes"]
        self.seq, self.status, self._last = own["seq"], own["status"], own["last"]
        self.lines, self.refused = own["lines"], own["refused"]
        self._clock.load(own["clock"])
        self._fits = set(own["fits"])
        for name, samples in own["inputs"].items():
            self._inputs[name].samples = saved.samples_in(samples)
        self._waiting.epochs = saved.waiting_in(own["waiting"])
