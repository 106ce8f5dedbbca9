"""Thousands of mutated inputs: each is refused by a named error, or taken; nothing in between.

    python tests/faults/fuzz.py --lines 1000000 --scenarios 10000 --tables 10000 --seed 1

Lines of a stream: no exception, whatever comes, and after each line that was refused the
session is as before: estimate, covariance, clock, inputs and epochs that wait, counters other
than those of refusals; some sessions have a journal, which is then read back to the same state.
Scenarios and tables: a RelnavError, or they are valid; and nothing takes seconds. What breaks
this is printed with its seed; the exit code is 1 then.
"""

from __future__ import annotations

import sys
from pathlib import Path

sys.path[:0] = [str(Path(__file__).parents[1] / name) for name in ("support", "manual")]

if __name__ == "__main__":
    from fuzzing import main

    sys.exit(main())
