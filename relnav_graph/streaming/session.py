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
from relnav_graph.core.epochs import Epoch, stamped
from relnav_graph.core.measurement import SAME_TIME, Measurement
from relnav_graph.core.models import derived_quantities
from relnav_graph.core.packing import under
from relnav_graph.core.problem import Prior, Problem
from relnav_graph.errors import InputError, RelnavError
from relnav_graph.estimators.online.driver import Estimate, Online
from relnav_graph.streaming import saved
from relnav_graph.streaming.beginning import Beginning
from relnav_graph.streaming.buffers import InputBuffer, Inputs, Waiting, WaitingEpoch
from relnav_graph.streaming.lines import (
    Header,
    InputSample,
    LineError,
    Tick,
    estimate_object,
    parse_line,
)
from relnav_graph.streaming.options import PATIENCE, Options, Parsed
from relnav_graph.streaming.right_units import check_inputs, misfits

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
        self.rejected: dict[str, dict[str, int]] = {}
        self.seq = 0
        self.status = "LOST"
        self.lines = 0
        self._origin = origin
        self._patience = options.patience or problem.window or PATIENCE
        self._derived = derived_quantities(problem.layout)
        self._waiting = Waiting(problem.merge)
        self._inputs = Inputs({name: InputBuffer(name) for name in self.columns})
        self._heard = -np.inf  # newest time of arrival, s: the "now" of the stream
        self._last = -1  # number `n` of the last line in
        self._notes: list[dict[str, Any]] = []  # rejected since the last line out
        self._fits: set[str] = set()  # sensors whose unit was checked and is right
        self._bridged = -np.inf  # end of the last gap in the inputs that was bridged
        self._beginning = Beginning(problem, measured) if measured else None
        self._doubt = ""  # of the prior that was measured
        self._begun_at: float | None = None  # time of the first line out
        self.cautions: tuple[Caution, ...] = ()
        if header.t is not None:
            self._heard = header.t
            self._waiting.at(header.t, header.t)

    # --- lines in ------------------------------------------------------------------------

    def parse(self, raw: bytes) -> Parsed:
        """The content of a line, checked; changes no state."""
        try:
            return Parsed(*parse_line(raw, self.problem.sensors, self.columns, self._origin))
        except LineError as error:
            return Parsed(None, error)

    def repeats(self, line: Parsed) -> bool:
        """Whether a line is a repetition, by the sender, of an earlier one."""
        return line.n is not None and line.n <= self._last

    def take(self, line: Parsed) -> list[LineOut]:
        """Process a line in; the lines out that result."""
        self.lines += 1
        self._last = self._last if line.n is None else line.n
        item = line.item
        if isinstance(item, LineError):
            self._reject(item.sensor, item.t, None, item.reason)
        elif isinstance(item, Header):
            if self.lines > 1:
                self._reject(None, None, None, "header: found one after the first line")
        else:
            self._hear(item)
        return self._advance(everything=False)

    def pause(self) -> list[LineOut]:
        """The lines out at a pause: the newest epoch need not wait for a later arrival."""
        return self._advance(everything=True)

    @property
    def busy(self) -> bool:
        """Whether epochs wait, so that a pause could give lines out."""
        return bool(self._waiting.epochs)

    def end(self) -> list[LineOut]:
        """The end of the stream, and of what still waits; the last line, if any is due."""
        out = self._begun() if self._beginning is not None and self._beginning.epochs else []
        out += self._advance(everything=True, ended=True)
        if self._notes:
            out.append(self._line(self.online.t, self.status, "the end of the stream", None))
        return out

    def _reject(self, sensor: str | None, t: float | None, id: int | None, reason: str) -> None:
        counts = self.rejected.setdefault(sensor or "(unnamed)", {})
        kind = reason.partition(":")[0]
        # However the reasons read, there are few of them: memory stays flat.
        kind = kind if kind in counts or len(counts) < 20 else "other"
        counts[kind] = counts.get(kind, 0) + 1
        if len(self._notes) < 1000:
            self._notes.append({"sensor": sensor, "t": t, "id": id, "reason": reason})

    def _refuse(self, epoch: WaitingEpoch, reason: str) -> None:
        for m in epoch.measurements:
            for i in m.ids.tolist():
                self._reject(m.sensor, m.t, i, reason)

    def _hear(self, item: Measurement | InputSample | Tick) -> None:
        """Buffer a measurement, an input or an epoch; reject it when its times are wrong."""
        name = item.name if isinstance(item, InputSample) else getattr(item, "sensor", None)
        t = item.t_end if isinstance(item, InputSample) else item.t
        arrival = t if item.t_arrival is None else item.t_arrival
        try:
            self._check_times(item, t, arrival)
            if isinstance(item, InputSample):
                if not self._inputs[item.name].add(item):
                    raise InputError("duplicate: of an input that is there already")
            else:
                epoch = self._waiting.at(item.t, arrival)
                if isinstance(item, Measurement):
                    epoch.measurements.append(stamped(item, epoch.t))
        except InputError as error:
            ids = item.ids.tolist() if isinstance(item, Measurement) else [None]
            for i in ids:
                self._reject(name, t, i, str(error))
        else:
            self._heard = max(self._heard, arrival)

    def _check_times(
        self, item: Measurement | InputSample | Tick, t: float, arrival: float
    ) -> None:
        limit = self.options.max_gap
        if arrival < t - SAME_TIME:
            raise InputError(f"clock: it arrives at {arrival} s, before its own time")
        far = max(abs(time - self._heard) for time in (t, arrival))
        if self._heard > -np.inf and far > limit:
            raise InputError(
                f"clock: {far:.6g} s from the newest time heard of, {self._heard:.6g} s; above"
                f" {limit:g} s it is taken to be of another clock (--max-gap)"
            )
        if self.header.t is not None and t < self.header.t - SAME_TIME:
            raise InputError(f"late: before the prior, which is of {self.header.t} s")
        now, start = self.online.t, self._window_start
        if isinstance(item, InputSample):
            if now is not None and t <= now + SAME_TIME:
                raise InputError(f"late: an input of a time before the newest epoch, {now} s")
        elif now is not None and t < start - SAME_TIME:
            raise InputError(f"late: before the window, which begins at {start} s")

    @property
    def _window_start(self) -> float:
        """Time, s, before which a measurement comes too late to be used."""
        epochs = self.online.epochs
        return epochs[0].t if epochs else -np.inf

    # --- epochs --------------------------------------------------------------------------

    @property
    def _reached(self) -> float | None:
        """Time of the newest epoch estimated, or held back before the first estimate, s."""
        return self.online.t if self._beginning is None else self._beginning.t

    def _advance(self, everything: bool, ended: bool = False) -> list[LineOut]:
        """Take in the epochs that are complete, in order of time; in the end, all of them."""
        out = []
        while self._waiting.epochs:
            epoch = self._waiting.epochs[0]
            if not everything and epoch.arrival >= self._heard - SAME_TIME:
                break
            now = self._reached
            if now is not None and epoch.t > now and self._lacking(epoch.t):
                if self._heard - epoch.t <= self._patience and not ended:
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
            gaps = self._inputs.gaps(self.problem.bridges, now, t)
        except InputError as error:
            return f"no inputs: {error}"
        for name, start, end in gaps:
            self._bridged = max(self._bridged, end)
            self._reject(name, end, None, f"gap: nothing from {start} s to {end} s; bridged")
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
        held, (prior, self._doubt) = self._beginning.epochs, self._beginning.prior()
        self._beginning, self.online = None, self.online.from_prior(prior)
        self.problem = self.online.problem
        out = list[LineOut]()
        for e in held:
            out += self._estimate(WaitingEpoch(e.t, e.t, list(e.measurements)))
        return out

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
                for m, reason in misfits(*first):
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

    def _begin_at(self, t: float | None) -> None:
        """Note the time of the first line out, s."""
        self._begun_at = t
        self.cautions = () if t is None else self.problem.cautions_from(t)

    def _found(self, found: Estimate) -> LineOut:
        status, message = found.status, found.message
        if status == "OK" and found.t <= self._bridged + self._patience:
            status, message = "DEGRADED", f"the inputs had a gap until {self._bridged} s"
        if self._doubt:
            status = "DEGRADED" if status == "OK" else status
            message = "; ".join(filter(None, [message, self._doubt]))
        return self._line(found.t, status, message, (found.x, found.P))

    def _without(self, t: float, reason: str) -> LineOut:
        """The line out of an epoch whose update failed: the prediction to it."""
        now, status = self.online.t, self.online.health(t)[0]
        status = "DEGRADED" if status == "OK" else status
        try:
            if now is None or t < now:
                return self._line(t, "LOST", reason, None)
            return self._line(t, status, reason, self.online.predict(t, self._since(now, t)))
        except (RelnavError, np.linalg.LinAlgError):
            return self._line(t, "LOST", reason, None)

    def _line(
        self, t: float | None, status: str, message: str, found: tuple[Array, Array] | None
    ) -> LineOut:
        self.status = status
        if self._begun_at is None:
            self._begin_at(t)
        line: LineOut = {"seq": self.seq, "t": t, "status": status, "message": message}
        if self.cautions:
            line["cautions"] = [vars(c) for c in self.cautions]
        line["estimate"] = None if found is None else self._object(*found)
        if self.options.predict_to_now and found is not None and t is not None:
            line["now"] = self._now(t, found)
        line["rejected"] = self._notes
        self._notes, self.seq = [], self.seq + 1
        return line

    def _object(self, x: Array, P: Array) -> dict[str, Any]:
        return estimate_object(self.problem.layout, self._derived, x, P)

    def _now(self, t: float, found: tuple[Array, Array]) -> dict[str, Any]:
        """The prediction to the newest time of arrival; inputs are held beyond their end."""
        newest = self.online.t
        if newest is not None and t == newest and self._heard > t + SAME_TIME:
            try:
                found = self.online.predict(self._heard, self._since(t, self._heard, hold=True))
                return {"t": self._heard, "estimate": self._object(*found)}
            except (RelnavError, np.linalg.LinAlgError):
                return {"t": self._heard, "estimate": None}
        return {"t": t, "estimate": self._object(*found)}

    # --- as bytes --------------------------------------------------------------------------

    def save(self) -> bytes:
        """All of its state as bytes."""
        own = {
            "header": saved.header_object(self.header),
            "rejected": self.rejected,
            "seq": self.seq,
            "status": self.status,
            "lines": self.lines,
            "heard": self._heard,
            "last": self._last,
            "notes": self._notes,
            "fits": sorted(self._fits),
            "bridged": self._bridged,
            "doubt": self._doubt,
            "begun_at": self._begun_at,
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
        self._doubt = own["doubt"]
        self._begin_at(own.get("begun_at"))
        self.online.restore(arrays)
        self.rejected, self.seq, self.status = own["rejected"], own["seq"], own["status"]
        self.lines, self._heard, self._last = own["lines"], own["heard"], own["last"]
        self._notes, self._fits, self._bridged = own["notes"], set(own["fits"]), own["bridged"]
        for name, samples in own["inputs"].items():
            self._inputs[name].samples = saved.samples_in(samples)
        self._waiting.epochs = saved.waiting_in(own["waiting"])
