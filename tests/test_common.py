"""Unknowns that a few measurements share, against least squares with the unknowns as columns."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import minimize_scalar

from geograph import blocks as module
from geograph.blocks import BlockSum, ColumnLayout, Sums
from geograph.common import Common, project, settled
from geograph.families.base import Evaluation, path_only_evaluation
from geograph.losses import Loss

PROFILE = settings(max_examples=60, deadline=None, derandomize=True)
seeds = st.integers(0, 2**32 - 1)
# Sets of one, of two, of many, in all mixtures.
sizes = st.lists(st.sampled_from([1, 1, 2, 3, 7]), min_size=1, max_size=6)
losses = st.sampled_from(["none", "huber", "cauchy", "geman-mcclure"])


def random_sets(rng, counts, *, prior, width=6, constants=0, interval=None, spread=1.0):
    """Return an evaluation of sets that share one unknown each."""
    group = np.repeat(np.arange(len(counts)), counts)
    count = group.size
    start = np.concatenate([[0], np.cumsum(counts)[:-1]])
    information = rng.uniform(0.2, 3.0, len(counts)) if prior else np.zeros(len(counts))
    common = Common(group, start, rng.uniform(0.5, 2.0, count), information, np.zeros(len(counts)))
    where = np.zeros(count, dtype=np.int64) if interval is None else interval[group]
    touched = rng.random((count, constants)) < 0.5
    row, column = np.nonzero(touched)
    none = np.empty(0, dtype=np.int64)
    return Evaluation(
        spread * rng.normal(size=(count, 1)), where, rng.normal(size=(count, 1, 2, width)),
        row, column, rng.normal(size=(row.size, 1)),
        none, none, np.empty(0), np.empty(0), np.empty((0, 1)), common,
    )  # fmt: skip


def cost_of(found, weight, loss, value):
    """The cost of one group's rows at a value of their unknown, for group zero alone."""
    square = (found.residual[:, 0] + found.common.by_common * value) ** 2
    return 0.5 * weight @ loss.value_and_weight(square)[0] + 0.5 * (
        found.common.information[0] * value**2
    )


def total_cost(found, weight, loss):
    square = found.residual[:, 0] ** 2
    return 0.5 * weight @ loss.value_and_weight(square)[0] + found.common.cost


@PROFILE
@given(seed=seeds, count=st.sampled_from([1, 2, 3, 9]), prior=st.booleans(), loss=losses,
       weighted=st.booleans())  # fmt: skip
def test_the_cost_is_the_least_over_the_unknown(*, seed, count, prior, loss, weighted):
    rng = np.random.default_rng(seed)
    found = random_sets(rng, [count], prior=prior)
    weight = rng.uniform(0.1, 1.0, count) if weighted else np.ones(count)
    chosen = Loss(loss)
    done = settled(found, weight if weighted else None, chosen)
    # The valley that its start, zero, lies in: these residuals are well within the losses' scales.
    best = minimize_scalar(
        lambda value: cost_of(found, weight, chosen, value),
        bracket=(done.common.value[0] - 0.1, done.common.value[0] + 0.1),
        tol=1e-12,
    )
    assert total_cost(done, weight, chosen) == pytest.approx(best.fun, rel=1e-7, abs=1e-9)
    expected = found.residual[:, 0] + found.common.by_common * done.common.value[0]
    np.testing.assert_allclose(done.residual[:, 0], expected, rtol=1e-12, atol=1e-12)
    if loss in ("none", "huber"):
        # Convex: there is no other.
        grid = np.linspace(-20.0, 20.0, 4001)
        least = min(cost_of(found, weight, chosen, value) for value in grid)
        assert total_cost(done, weight, chosen) <= least + 1e-9


@PROFILE
@given(seed=seeds, counts=sizes, prior=st.booleans(), weighted=st.booleans())
def test_settled_sets_do_not_feel_each_other(*, seed, counts, prior, weighted):
    rng = np.random.default_rng(seed)
    found = random_sets(rng, counts, prior=prior)
    weight = rng.uniform(0.1, 1.0, sum(counts)) if weighted else None
    done = settled(found, weight, Loss("none"))
    common = found.common
    for index, (first, count) in enumerate(zip(common.start, counts, strict=True)):
        own = slice(first, first + count)
        w = np.ones(count) if weight is None else weight[own]
        # The unknown as a column of its own, beside its prior.
        rows = np.append(np.sqrt(w) * common.by_common[own], np.sqrt(common.information[index]))
        right = np.append(np.sqrt(w) * found.residual[own, 0], 0.0)
        value = -np.linalg.lstsq(rows[:, None], right, rcond=None)[0][0]
        assert done.common.value[index] == pytest.approx(value, rel=1e-9, abs=1e-12)


def joint(rows, residual, by_common, group, information):
    """Information and gradient of everything else, the unknowns eliminated as columns."""
    unknowns = np.zeros((group.size, information.size))
    unknowns[np.arange(group.size), group] = by_common
    full = np.concatenate([rows, unknowns], axis=1)
    matrix = full.T @ full
    width = rows.shape[1]
    matrix[width:, width:] += np.diag(information)
    gradient = full.T @ residual
    pull = np.linalg.pinv(matrix[width:, width:], rcond=1e-12)
    schur = matrix[:width, :width] - matrix[:width, width:] @ pull @ matrix[width:, :width]
    return schur, gradient[:width] - matrix[:width, width:] @ pull @ gradient[width:]


@PROFILE
@given(seed=seeds, counts=sizes, prior=st.booleans(), left_out=st.booleans())
def test_projected_rows_are_the_schur_complement(*, seed, counts, prior, left_out):
    rng = np.random.default_rng(seed)
    found = random_sets(rng, counts, prior=prior)
    common = found.common
    weight = rng.choice([0.0, 0.5, 1.0], sum(counts)) if left_out else np.ones(sum(counts))
    root = np.sqrt(weight)
    rows = root[:, None] * rng.normal(size=(sum(counts), 5))
    by_common = root * common.by_common
    schur, gradient = joint(
        rows, root * found.residual[:, 0], by_common, common.group, common.information
    )
    done = settled(found, weight, Loss("none"))
    dense = np.concatenate([rows, root[:, None] * done.residual], axis=1)
    project(dense, by_common, common.group, common.start, common.information)
    product = dense.T @ dense
    np.testing.assert_allclose(product[:-1, :-1], schur, rtol=0.0, atol=1e-12 * len(rows))
    np.testing.assert_allclose(product[:-1, -1], gradient, rtol=0.0, atol=1e-11 * len(rows))
    # The square of the projected residual is what the cost says, the unknown's prior included.
    assert product[-1, -1] == pytest.approx(
        2.0 * total_cost(done, weight, Loss("none")), rel=1e-9, abs=1e-12
    )


@pytest.mark.parametrize("ratio", [1e-12, 1e-6, 1e6, 1e12])
def test_unknowns_that_are_nearly_free_and_nearly_known(ratio):
    """The prior's information over that of the measurements, from nothing to everything."""
    rng = np.random.default_rng(1)
    by_common = rng.uniform(0.5, 2.0, 4)
    information = np.array([ratio * by_common @ by_common])
    rows = rng.normal(size=(4, 3))
    residual = rng.normal(size=4)
    group, start = np.zeros(4, dtype=np.int64), np.zeros(1, dtype=np.int64)
    value = -(by_common @ residual) / (by_common @ by_common + information[0])
    dense = np.column_stack([rows, residual + by_common * value])
    project(dense, by_common, group, start, information)
    schur, gradient = joint(rows, residual, by_common, group, information)
    product = dense.T @ dense
    np.testing.assert_allclose(product[:-1, :-1], schur, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(product[:-1, -1], gradient, rtol=1e-5, atol=1e-6 * ratio**-0.5)


@PROFILE
@given(seed=seeds, counts=sizes, prior=st.booleans(), weighted=st.booleans(), loss=losses)
def test_leverage_is_the_share_of_the_variance_that_the_unknown_takes(
    *, seed, counts, prior, weighted, loss
):
    """Var(r) of settled residuals, for noise of one and the unknown from its prior."""
    rng = np.random.default_rng(seed)
    found = random_sets(rng, counts, prior=prior)
    total = sum(counts)
    weight = rng.choice([0.0, 0.4, 1.0], total) if weighted else None
    done = settled(found, weight, Loss(loss))
    factor = np.ones(total) if weight is None else weight
    factor = factor * Loss(loss).value_and_weight(done.residual[:, 0] ** 2)[1]
    common = found.common
    for index, (first, count) in enumerate(zip(common.start, counts, strict=True)):
        own = slice(first, first + count)
        a, w, q = common.by_common[own], factor[own], common.information[index]
        hold = (w * a) @ a + q
        keep = np.eye(count)
        if hold > 0.0:
            keep -= np.outer(a, w * a) / hold
        noise = np.eye(count)
        covariance = keep @ noise @ keep.T
        if q > 0.0:
            covariance += np.outer(keep @ a, keep @ a) / q
        np.testing.assert_allclose(
            1.0 - done.common.leverage()[own], np.diagonal(covariance), rtol=1e-7, atol=1e-9
        )


@PROFILE
@given(
    seed=seeds,
    counts=sizes,
    prior=st.booleans(),
    weighted=st.booleans(),
    buffer_bytes=st.sampled_from([2**26, 1200, 1]),
)
def test_blocks_of_sets_larger_and_smaller_than_a_pass(
    *, seed, counts, prior, weighted, buffer_bytes
):
    rng = np.random.default_rng(seed)
    layout = ColumnLayout(6, 0, 2, chained=True)
    # Sets of one emission lie in one interval, in no order.
    interval = rng.integers(0, 3, len(counts))
    found = random_sets(rng, counts, prior=prior, constants=2, interval=interval)
    weight = rng.uniform(0.1, 1.0, sum(counts)) if weighted else np.ones(sum(counts))
    done = settled(found, weight, Loss("none"))
    sums = Sums.zeros(layout, 3, apart=True)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(module, "_BUFFER_BYTES", buffer_bytes)
        BlockSum(layout, np.ones(6)).add(sums, done, np.sqrt(weight) if weighted else None)
    total = sums.full()
    dense = np.zeros((sum(counts), layout.width - 1))
    dense[:, :12] = found.by_knots.reshape(-1, 12)
    dense[found.constant_row, 12 + found.constant_column] = found.by_constants[:, 0]
    root = np.sqrt(weight)
    for k in range(3):
        own = found.interval == k
        _, group = np.unique(found.common.group[own], return_inverse=True)
        if not own.any():
            assert not total[k].any()
            continue
        which = np.unique(found.common.group[own])
        schur, gradient = joint(
            root[own, None] * dense[own], (root * found.residual[:, 0])[own],
            (root * found.common.by_common)[own], group, found.common.information[which],
        )  # fmt: skip
        np.testing.assert_allclose(total[k][:-1, :-1], schur, rtol=0.0, atol=1e-11)
        np.testing.assert_allclose(total[k][:-1, -1], gradient, rtol=0.0, atol=1e-10)


def test_the_order_of_rows_within_a_set_does_not_matter():
    rng = np.random.default_rng(2)
    found = random_sets(rng, [4], prior=True)
    order = np.array([2, 0, 3, 1])
    common = found.common
    turned = Evaluation(
        found.residual[order], found.interval, found.by_knots[order], found.constant_row,
        found.constant_column, found.by_constants, found.walk_row, found.walk_column,
        found.walk_before, found.walk_after, found.by_walks,
        Common(common.group, common.start, common.by_common[order], common.information,
               common.value),
    )  # fmt: skip
    loss = Loss("cauchy")
    one, other = settled(found, None, loss), settled(turned, None, loss)
    np.testing.assert_allclose(other.residual, one.residual[order], rtol=1e-9)
    assert other.common.value[0] == pytest.approx(one.common.value[0], rel=1e-9)


def test_a_set_that_is_left_out_altogether_moves_nothing():
    rng = np.random.default_rng(3)
    found = random_sets(rng, [3, 2], prior=False)
    weight = np.array([0.0, 0.0, 0.0, 1.0, 1.0])
    done = settled(found, weight, Loss("none"))
    np.testing.assert_array_equal(done.residual[:3], found.residual[:3])
    assert done.common.value[0] == 0.0
    dense = np.sqrt(weight)[:, None] * rng.normal(size=(5, 4))
    project(
        dense, np.sqrt(weight) * found.common.by_common, found.common.group, found.common.start,
        found.common.information,
    )  # fmt: skip
    assert not dense[:3].any()
    assert np.isfinite(dense).all()


def test_what_shares_nothing_stays_as_it_is():
    plain = path_only_evaluation(np.ones((2, 1)), np.zeros(2, dtype=np.int64), None)
    assert settled(plain, None, Loss("cauchy")) is plain


def test_a_residual_that_is_not_a_number_stays_one_in_its_own_set():
    rng = np.random.default_rng(4)
    found = random_sets(rng, [2, 2], prior=False)
    found.residual[0] = np.nan
    for loss in ("none", "cauchy"):
        done = settled(found, None, Loss(loss))
        assert np.isnan(done.residual[:2]).any()
        assert np.isfinite(done.residual[2:]).all()
