"""Information blocks against the products of dense rows."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from geograph import blocks as module
from geograph.blocks import BlockSum, ColumnLayout, Sums
from geograph.families import Evaluation

PROFILE = settings(max_examples=40, deadline=None, derandomize=True)


def random_evaluation(rng, layout, interval, rows):
    """Return an evaluation with random sparsity in the sensor states."""
    count, path = interval.size, layout.path
    sparse = {}
    for name, width in (("constant", layout.constants), ("walk", layout.walks)):
        touched = rng.random((count, width)) < 0.4
        row, column = np.nonzero(touched)
        sparse[name] = row, column, rng.normal(size=(row.size, rows))
    return Evaluation(
        residual=rng.normal(size=(count, rows)),
        interval=interval,
        by_path=rng.normal(size=(count, rows, 2, path)),
        constant_row=sparse["constant"][0],
        constant_column=sparse["constant"][1],
        by_constants=sparse["constant"][2],
        walk_row=sparse["walk"][0],
        walk_column=sparse["walk"][1],
        walk_before=rng.random(sparse["walk"][0].size),
        walk_after=rng.random(sparse["walk"][0].size),
        by_walks=sparse["walk"][2],
    )


def expected_blocks(layout, intervals, scale, found, root):
    """Add one measurement after another."""
    total = np.zeros((intervals, layout.width, layout.width))
    for n, interval in enumerate(found.interval):
        rows = np.zeros((found.residual.shape[1], layout.width))
        rows[:, : layout.path] = found.by_knots[n, :, 0] * scale
        if layout.chained:
            rows[:, layout.knot : layout.knot + layout.path] = found.by_knots[n, :, 1] * scale
        for entry in np.flatnonzero(found.constant_row == n):
            rows[:, layout.states + found.constant_column[entry]] = found.by_constants[entry]
        for entry in np.flatnonzero(found.walk_row == n):
            column = layout.path + found.walk_column[entry]
            rows[:, column] = found.walk_before[entry] * found.by_walks[entry]
            rows[:, column + layout.knot] = found.walk_after[entry] * found.by_walks[entry]
        rows[:, -1] = found.residual[n]
        if root is not None:
            rows *= root[n]
        total[interval] += rows.T @ rows
    return total


@PROFILE
@given(
    seed=st.integers(0, 2**32 - 1),
    intervals=st.integers(1, 6),
    count=st.sampled_from([1, 5, 40, 300]),
    rows=st.integers(1, 2),
    walks=st.integers(0, 2),
    constants=st.integers(0, 3),
    chained=st.booleans(),
    weighted=st.booleans(),
    buffer_bytes=st.sampled_from([2**26, 2**14, 1]),
    apart=st.booleans(),
)
def test_blocks_are_sums_of_products(
    *, seed, intervals, count, rows, walks, constants, chained, weighted, buffer_bytes, apart
):
    rng = np.random.default_rng(seed)

    def together(blocks):
        """Put what concerns the constants alone into the first interval, if it is not apart."""
        found = blocks.copy()
        if not apart:
            found[:, layout.states :, layout.states :] = 0.0
            found[0, layout.states :, layout.states :] = blocks[
                :, layout.states :, layout.states :
            ].sum(axis=0)
        return found

    if not chained:
        intervals, walks = 1, 0
    layout = ColumnLayout(6, walks, constants, chained=chained)
    # Some intervals stay empty, some are crowded, in no order.
    interval = rng.choice(rng.integers(0, intervals, 3), count)
    found = random_evaluation(rng, layout, interval, rows)
    scale = rng.uniform(0.5, 2.0, 6)
    root = rng.random(count) if weighted else None
    total = Sums.zeros(layout, intervals, apart=apart)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(module, "_BUFFER_BYTES", buffer_bytes)
        sums = BlockSum(layout, scale)
        sums.add(total, found, root)
        expected = expected_blocks(layout, intervals, scale, found, root)
        np.testing.assert_allclose(total.full(), together(expected), rtol=1e-11, atol=1e-11)
        # Kept bookkeeping must notice that measurements moved to other intervals.
        moved = random_evaluation(rng, layout, rng.permutation(interval)[::-1].copy(), rows)
        sums.add(total, moved, root)
    expected += expected_blocks(layout, intervals, scale, moved, root)
    np.testing.assert_allclose(total.full(), together(expected), rtol=1e-11, atol=1e-11)


def test_layout_of_columns():
    chain = ColumnLayout(9, 2, 5, chained=True)
    assert (chain.knot, chain.states, chain.width) == (11, 22, 28)
    alone = ColumnLayout(3, 0, 5, chained=False)
    assert (alone.knot, alone.states, alone.width) == (3, 3, 9)
