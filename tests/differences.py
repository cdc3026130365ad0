"""Derivatives by differences, for checking analytic ones."""

import numpy as np


def derivative(function, point, steps, *, with_change=False):
    """Return d(function)/d(point), shape (m, n), by Richardson-extrapolated central differences.

    Steps are h and h/2; the truncation error is of the order of (h / scale)^4 and the rounding
    error of eps times scale / h, both below 1e-11 for steps of a thousandth of the scale on which
    the function varies. With ``with_change`` the difference between both steps is returned too.
    """
    point = np.asarray(point, dtype=np.float64)
    steps = np.broadcast_to(steps, point.shape)
    columns, changes = [], []
    for index in range(point.size):

        def central(h, index=index):
            sides = []
            for sign in (1.0, -1.0):
                moved = point.copy()
                moved[index] += sign * h
                # The step that was taken, after rounding.
                sides.append((moved[index] - point[index], np.asarray(function(moved)).ravel()))
            (up, above), (down, below) = sides
            return (above - below) / (up - down)

        coarse, fine = central(steps[index]), central(steps[index] / 2.0)
        columns.append((4.0 * fine - coarse) / 3.0)
        changes.append(np.abs(fine - coarse))
    if with_change:
        return np.stack(columns, axis=1), np.stack(changes, axis=1)
    return np.stack(columns, axis=1)


def assert_derivative(analytic, function, point, steps, *, rtol=1e-7, floor=0.0):
    """Compare an analytic derivative with differences, column by column.

    The tolerance of a column is relative to its largest entry, and to the largest effect of any
    column per step (what a step moves at all), below which an entry cannot be told from rounding.
    Where both steps differ by the share e, extrapolation leaves an error of the order of e^2.
    """
    steps = np.broadcast_to(steps, np.shape(point))
    expected, change = derivative(function, point, steps, with_change=True)
    analytic = np.reshape(analytic, expected.shape)
    scale = np.abs(expected).max(axis=0)
    overall = np.max(scale * steps, initial=0.0)
    bound = rtol * np.maximum(scale, np.maximum(overall, floor) / steps)
    bound = bound + 3.0 * change**2 / np.where(scale > 0.0, scale, 1.0)
    worst = np.abs(analytic - expected) / bound
    assert np.isfinite(analytic).all()
    assert worst.max(initial=0.0) <= 1.0, (
        f"entry {np.unravel_index(np.argmax(worst), worst.shape)} differs by "
        f"{worst.max():.3g} times the tolerance: {analytic.flat[np.argmax(worst)]} instead of "
        f"{expected.flat[np.argmax(worst)]}"
    )
