"""Student's t as a loss: its minimum is the maximum of the likelihood."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import minimize
from scipy.stats import multivariate_t

from relnav_graph.arrays import Array
from relnav_graph.maths.losses import TUNING, Loss, loss_costs, root_weights

NU = 4


@pytest.mark.parametrize("rows", [1, 3])
def test_student_t_finds_the_likeliest_place(rows: int) -> None:
    rng = np.random.default_rng(rows)
    z = 2.0 + multivariate_t(np.zeros(rows), np.eye(rows), NU).rvs(40, random_state=rng)
    z = z.reshape(40, rows)
    losses, x = np.tile(Loss("student_t", NU).numbers(rows), (40, 1)), z.mean(axis=0)
    for _ in range(200):
        weights = root_weights(losses, np.square(z - x).mean(axis=1)) ** 2
        x = weights @ z / weights.sum()

    def cost(y: Array) -> float:
        return -float(multivariate_t(y, np.eye(rows), NU).logpdf(z).sum())

    best = minimize(cost, np.median(z, axis=0), method="BFGS", options={"gtol": 1e-9})
    np.testing.assert_allclose(x, best.x, atol=1e-6)


@pytest.mark.parametrize("rows", [1, 2, 4])
def test_student_t_weighs_its_own_errors_as_one_in_the_mean(rows: int) -> None:
    count = 200_000
    r = multivariate_t(np.zeros(rows), np.eye(rows), NU).rvs(count, random_state=7)
    s2 = np.square(r.reshape(count, rows)).mean(axis=1)
    weights = root_weights(np.tile(Loss("student_t", NU).numbers(rows), (count, 1)), s2) ** 2
    assert weights.mean() == pytest.approx(1.0, abs=0.01)
    # The information of the errors, by the square of the score: what normal errors have, less.
    information = np.mean(weights**2 * s2)
    assert information == pytest.approx((NU + rows) / (NU + rows + 2), abs=0.01)


@pytest.mark.parametrize("kind", list(TUNING))
def test_a_weight_is_the_slope_of_its_loss(kind: str) -> None:
    losses: Array = np.tile(Loss(kind).numbers(3), (40, 1))  # type: ignore[arg-type]
    s2, h = np.linspace(0.01, 60.0, 40), 1e-5
    slope = (loss_costs(losses, s2 + h) - loss_costs(losses, s2 - h)) / (2 * h)
    np.testing.assert_allclose(slope, 0.5 * root_weights(losses, s2) ** 2, atol=1e-8)
    assert loss_costs(losses[:1], np.zeros(1)) == 0.0
