"""The verdict on declared noises of a recorded pass whose truth is known."""

from __future__ import annotations

from typing import Any

import pytest

from relnav_graph.scoring.noise_verdict import beside_truth


def verdict(factor: float, named: bool = True) -> dict[str, Any]:
    one = {"noise": "sensors.camera", "tested": True, "factor": factor, "named": named}
    return {"residuals_of": "batch", "noises": [one], "causes": [], "text": ["said before."]}


@pytest.mark.parametrize(
    ("noise", "row", "said"),
    [
        (verdict(0.4), {"anees": 1.02, "anees_band": [0.2, 2.4]}, True),
        (verdict(0.4), {"anees": 2.50, "anees_band": [0.2, 2.4]}, False),  # not as sure
        (verdict(0.4), {"anees": None, "anees_band": None}, False),  # truth does not know all
        (verdict(0.4, named=False), {"anees": 1.02, "anees_band": [0.2, 2.4]}, False),
        (verdict(2.0), {"anees": 1.02, "anees_band": [0.2, 2.4]}, False),  # declared too small
        ({"residuals_of": "batch", "missing": "why"}, {"anees": 1.0, "anees_band": [0, 2]}, False),
    ],
)
def test_a_larger_noise_that_truth_confirms_is_no_fault(
    noise: dict[str, Any], row: dict[str, Any], said: bool
) -> None:
    found = beside_truth(noise, {"ekf": {"anees": 9.0, "anees_band": [0, 2]}, "batch": row})
    text = noise.get("text", [])
    assert found.get("text", []) == [*text, *found.get("text", [])[len(text) :]]
    assert len(found.get("text", [])) == len(text) + said
    assert not said or found["text"][-1].startswith("Against the truth batch is as sure as it may")
