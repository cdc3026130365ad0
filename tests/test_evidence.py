"""Evidence of process noise, and its derivatives, against dense algebra."""

import numpy as np
import pytest
from test_eliminate import dense_form, random_system

from geograph.evidence import Evidence


def scaled(evidence, logs):
    return evidence.of(np.exp(0.5 * logs))


@pytest.mark.parametrize("undriven", [0, 2])
def test_scores_and_information(undriven):
    rng = np.random.default_rng(5)
    d, count, s = 5, 6, 2
    path = d - undriven
    evidence = Evidence(random_system(rng, count + 1, d, s, undriven=undriven), path)
    logs = rng.normal(size=count)
    found = evidence.scores(np.exp(0.5 * logs), information=True)
    assert found.evidence == pytest.approx(scaled(evidence, logs), rel=1e-12)
    step = 1e-5 * np.eye(count)
    slope = [(scaled(evidence, logs + e) - scaled(evidence, logs - e)) / 2e-5 for e in step]
    np.testing.assert_allclose(found.score, slope, rtol=1e-5, atol=1e-6)
    information, *_ = dense_form(evidence._scaled(np.exp(0.5 * logs)), 0.0)
    covariance = np.linalg.inv(information)
    for k in range(count):
        for j in range(count):
            rows = slice(d + k * d, d + k * d + path)
            columns = slice(d + j * d, d + j * d + path)
            known = (k == j) * np.eye(path) - covariance[rows, columns]
            assert found.information[k, j] == pytest.approx(0.5 * np.sum(known**2), rel=1e-6)
