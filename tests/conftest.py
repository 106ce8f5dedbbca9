"""What all tests share."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

#: Files whose tests look at figures; to draw them takes most of the time of the others.
DRAWN = {
    "test_drawing",
    "test_report",
    "test_figures",
    "test_cli",
    "test_scripts",
    "test_static_runs",
    "test_closed_loop",
}


@pytest.fixture(autouse=True, scope="module")
def _undrawn(request: pytest.FixtureRequest) -> Iterator[None]:
    """Leave out the figures of results where no test looks at them."""
    with pytest.MonkeyPatch.context() as patch:
        if request.module.__name__.rpartition(".")[2] not in DRAWN:
            patch.setattr("relnav_graph.figures.save_pass", lambda *_: [])
        yield
