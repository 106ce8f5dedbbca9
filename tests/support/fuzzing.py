"""What `tests/faults/fuzz.py` runs: mutated lines, scenarios and tables, and what must hold."""

from __future__ import annotations

import argparse
import json
import random
import tempfile
import time
import tomllib
import traceback
import warnings
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import tomli_w
from mutations import mutated_bytes, mutated_line, mutated_object
from streams import SCENARIO, lines_of

from relnav_graph.cli.stream import new_session
from relnav_graph.errors import RelnavError
from relnav_graph.io.dataset import read_dataset, write_dataset
from relnav_graph.scenario.build import load_scenario, make_scenario
from relnav_graph.scenario.scenario import Scenario
from relnav_graph.streaming import saved
from relnav_graph.streaming.journal import Journal
from relnav_graph.streaming.lines import header_of
from relnav_graph.streaming.run import JournaledSession
from relnav_graph.streaming.session import Options, Session
from relnav_graph.streaming.writing import dump

EXPERIMENTS = Path(__file__).parents[2] / "experiments"
#: Lines of one session, and how often all of its state is compared, not only what is quick.
LENGTH, THOROUGH = 400, 100
#: Longest time for one input, s, on a machine that others use too.
SLOW = 5.0
#: What a refused line may change: counts and notes of refusals, and what follows from telling them.
REFUSALS = {"rejected", "refused", "notes", "lines", "seq", "status"}


class Broken(AssertionError):
    """An input that was neither taken nor refused as it should be."""


def _quick(session: Session) -> tuple[Any, ...]:
    """What tells a change, at little cost. The estimator's state is an immutable value."""
    clock = session._clock
    return (
        session.online._state,
        session._last,
        len(session._fits),
        session._doubts.save(),
        clock.heard,
        [(own.newest, own.step) for own in clock._own.values()],
        [(e.t, e.arrival, e.rows) for e in session._waiting.epochs],
        [(len(b.samples), b.samples[-1:]) for b in session._inputs.values()],
        None if session._beginning is None else (session._beginning.t, session._beginning.epochs),
    )


def _thorough(session: Session) -> tuple[Any, ...]:
    """All of its state, but for what tells of refusals."""
    own, arrays = saved.unpack(session.save())
    for o in own["clock"]["own"].values():
        del o["behind"], o["told"]
    kept = {k: v for k, v in own.items() if k not in REFUSALS}
    numbers = {name: array.tobytes() for name, array in arrays.items()}
    return json.dumps(kept), numbers, session.online.totals


def _same(a: tuple[Any, ...], b: tuple[Any, ...]) -> bool:
    return all(x is y or x == y for x, y in zip(a, b, strict=True))


class _Stream:
    """A good stream, and sessions of it."""

    def __init__(self, name: str, scenario: Scenario, kinds: tuple[str, ...]) -> None:
        self.name, self.scenario, self.kinds = name, scenario, kinds
        self.lines = lines_of(scenario)

    def session(self, rng: random.Random) -> Session:
        """New, in one of three cases with a mutated header, as far as that is one."""
        header = header_of(self.lines[0].encode())
        scenario = self.scenario
        while rng.random() < 0.3:
            try:
                found = header_of(mutated_line(rng, self.lines[0]))
                scenario = self.scenario
                if found.settings:
                    scenario = make_scenario(scenario.raw, self.name, found.settings)
                new_session(scenario, "ekf", found, Options())
                header = found if found.prior else header
            except RelnavError:
                continue
        options = Options(
            max_gap=rng.choice((3600.0, 100.0, 1e5)),
            patience=rng.choice((None, 5.0)),
            predict_to_now=rng.random() < 0.5,
        )
        return new_session(scenario, rng.choice(self.kinds), header, options)


def _check_take(session: Session, raw: bytes, take: Callable[[bytes], Any], full: bool) -> bool:
    """Give a line to a session; whether it was refused. Raises Broken, or whatever it raises."""
    refused, quick = session.refused, _quick(session)
    before = _thorough(session) if full else ()
    begun = time.process_time()
    for line in take(raw):
        dump(line)
    if time.process_time() - begun > SLOW:
        raise Broken(f"took {time.process_time() - begun:.1f} s")
    if session.refused == refused:
        return False
    if not _same(quick, _quick(session)) or (full and not _same(before, _thorough(session))):
        raise Broken("it was refused, and has changed something")
    return True


def _one_session(stream: _Stream, rng: random.Random, count: int, folder: Path | None) -> int:
    """Good and mutated lines mixed; how many were refused. Raises with the line in a note."""
    session = stream.session(rng)
    at, refused = 1 + rng.randrange(5), 0
    journal = None if folder is None else Journal(folder, "never")
    recorder = JournaledSession(session, journal, rng.choice((30, 1000)))
    recorder.begin()
    good = iter(stream.lines)
    for k in range(count):
        window = stream.lines[max(at - 10, 0) : at + 10]
        is_good = rng.random() < 0.1
        raw = next(good, "").encode() if is_good else mutated_line(rng, rng.choice(window))
        at += is_good
        if rng.random() < 0.02:
            raw = b""
            for line in recorder.pause():
                dump(line)
        try:
            refused += _check_take(session, raw, recorder.take, k % THOROUGH == 0)
        except Exception as error:
            error.add_note(f"line {k}: {raw[:2000]!r}")
            raise
    if journal is not None:
        journal.close()
        _check_journal(stream, recorder, folder)
    for line in recorder.session.end():
        dump(line)
    return refused


def _check_journal(stream: _Stream, recorder: JournaledSession, folder: Path | None) -> None:
    """What the journal holds gives the same session."""
    assert folder is not None
    session = recorder.session
    with Journal(folder, "never") as journal:
        fresh = new_session(stream.scenario, session.online.kind, session.header, session.options)
        again = JournaledSession(fresh, journal, 1000)
        again.begin()
    if again.session.save() != session.save():
        raise Broken("the journal gives another state")


def _streams() -> list[_Stream]:
    raw = tomllib.loads(SCENARIO)
    zhang = load_scenario(EXPERIMENTS / "zhang2015.toml", ["time.epochs=60"])
    raw["time"]["epochs"] = 60
    return [
        _Stream("toy", make_scenario(raw, "toy"), ("ekf", "fixed_lag", "incremental")),
        _Stream("zhang2015", zhang, ("ekf", "iekf")),
    ]


def _report(what: str, error: BaseException) -> str:
    text = "".join(traceback.format_exception(error)[-4:])
    return f"{what}: {text}{' '.join(getattr(error, '__notes__', []))}"


def fuzz_lines(count: int, seed: int) -> Iterator[str]:
    """What is wrong with `count` mutated lines."""
    streams, done, refused, number = _streams(), 0, 0, 0
    begun = time.monotonic()
    while done < count:
        rng = random.Random(f"{seed}:{number}")
        length = min(LENGTH, count - done)
        with tempfile.TemporaryDirectory() as folder:
            journal = Path(folder) if number % 20 == 0 else None
            try:
                with np.errstate(over="ignore", invalid="ignore"):
                    refused += _one_session(rng.choice(streams), rng, length, journal)
            except Exception as error:
                yield _report(f"lines, session {seed}:{number}", error)
        done, number = done + length, number + 1
        if number % 250 == 0:
            print(f"{done} lines, {refused} refused, {time.monotonic() - begun:.0f} s", flush=True)
    print(f"{done} lines, {refused} refused, {time.monotonic() - begun:.0f} s", flush=True)


def _tried(what: str, work: Callable[[], object]) -> tuple[bool, str]:
    """Whether an input was refused; and what is wrong with how, or ""."""
    begun = time.process_time()
    refused, wrong = False, ""
    try:
        work()
    except RelnavError:
        refused = True
    except Exception as error:
        wrong = _report(what, error)
    took = time.process_time() - begun
    return refused, wrong or (f"{what}: took {took:.1f} s" if took > SLOW else "")


def fuzz_scenarios(count: int, seed: int) -> Iterator[str]:
    """What is wrong with `count` mutated scenario files."""
    texts = [p.read_text("utf-8") for p in sorted(EXPERIMENTS.glob("*.toml"))]
    raws = [raw for raw in map(tomllib.loads, texts) if "base" not in raw]
    refused = 0
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "scenario.toml"
        for k in range(count):
            rng = random.Random(f"{seed}:{k}")
            if rng.random() < 0.3:
                path.write_bytes(mutated_bytes(rng, rng.choice(texts).encode()))
            else:
                path.write_text(_toml(mutated_object(rng, rng.choice(raws))), "utf-8")
            was, wrong = _tried(f"scenario {seed}:{k}", lambda: load_scenario(path))
            refused += was
            if wrong:
                yield wrong + "\n" + path.read_text("utf-8", "replace")[:3000]
    print(f"{count} scenarios, {refused} refused", flush=True)


def _toml(raw: dict[str, Any]) -> str:
    """TOML has no null; an empty text stands for it."""
    text: str = tomli_w.dumps(json.loads(json.dumps(raw).replace("null", '""')))
    return text


def fuzz_tables(count: int, seed: int) -> Iterator[str]:
    """What is wrong with `count` mutated tables, of a data set that was written by hand."""
    scenario = load_scenario(EXPERIMENTS / "zhang2015.toml", ["time.epochs=8"])
    blocks = {b.name: b for b in scenario.layout}
    refused = 0
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name) / "data"
        models = scenario.sensors, scenario.input_columns, blocks
        write_dataset(folder, scenario.raw, scenario.simulate(0), *models)
        (folder / "dataset.toml").unlink()  # which holds the digests
        tables = {path: path.read_bytes() for path in sorted(folder.rglob("*.csv"))}
        for k in range(count):
            rng = random.Random(f"{seed}:{k}")
            path = rng.choice(list(tables))
            path.write_bytes(_mutated_table(rng, tables[path]))
            was, wrong = _tried(f"table {seed}:{k}", lambda: read_dataset(folder, *models))
            refused += was
            if wrong:
                yield f"{wrong}\n{path.name}: {path.read_bytes()[:3000]!r}"
            path.write_bytes(tables[path])
    print(f"{count} tables, {refused} refused", flush=True)


def _mutated_table(rng: random.Random, text: bytes) -> bytes:
    if rng.random() < 0.3:
        return mutated_bytes(rng, text)
    rows = [line.split(",") for line in text.decode().splitlines()]
    rows = mutated_object(rng, rows)
    lines = [row if isinstance(row, list) else [row] for row in rows]
    return "\n".join(",".join(map(str, line)) for line in lines).encode("utf-8", "replace")


MODES = {"lines": fuzz_lines, "scenarios": fuzz_scenarios, "tables": fuzz_tables}


def main() -> int:
    """Run what the command line asks for; 1 when something broke."""
    parser = argparse.ArgumentParser(description=__doc__)
    for mode in MODES:
        parser.add_argument(f"--{mode}", type=int, default=0)
    parser.add_argument("--seed", type=int, default=0)
    given = parser.parse_args()
    warnings.simplefilter("error")
    broken = 0
    for mode, fuzz in MODES.items():
        for found in fuzz(getattr(given, mode), given.seed) if getattr(given, mode) else ():
            print(found, flush=True)
            broken += 1
    print(f"{broken} broken", flush=True)
    return int(broken > 0)
