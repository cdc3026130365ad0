"""The door between GTSAM and NumPy: what a factor's function may return, and what it may not."""

import subprocess
import sys
import textwrap

import gtsam
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from geograph.factors import FactorError, vector_factor

MATRICES = [np.array([[1.0, 2.0, 3.0], [0.0, -1.0, 4.0]]), np.array([[0.5], [2.0]])]


def linear_factor(**changes):
    """A factor of a 3-vector (key 0) and a 1-vector (key 1) with an error of 2 rows."""

    def function(vectors, jacobian):
        error = MATRICES[0] @ vectors[0] + MATRICES[1] @ vectors[1] - 1.0
        result = {"error": error, "derivatives": MATRICES if jacobian else []} | changes
        return result["error"], result["derivatives"]

    return vector_factor([0, 1], [3, 1], 2, function)


def some_values():
    values = gtsam.Values()
    values.insert(0, np.array([0.3, -1.0, 2.0]))
    values.insert(1, np.array([0.7]))
    return values


def test_a_factor_has_the_error_and_the_derivatives_of_its_function():
    factor, values = linear_factor(), some_values()
    error = MATRICES[0] @ values.atVector(0) + MATRICES[1] @ values.atVector(1) - 1.0
    np.testing.assert_array_equal(factor.unwhitenedError(values), error)
    assert factor.error(values) == pytest.approx(0.5 * error @ error, rel=1e-15)
    linear = factor.linearize(values)
    jacobian, right = linear.jacobian()
    np.testing.assert_array_equal(jacobian, np.concatenate(MATRICES, axis=1))
    np.testing.assert_array_equal(right, -error)


def test_a_noise_model_whitens():
    noise = gtsam.noiseModel.Diagonal.Sigmas(np.array([2.0, 4.0]))
    factor = vector_factor(
        [0], [1], 2, lambda vectors, _: (np.repeat(vectors[0], 2), [np.ones((2, 1))]), noise=noise
    )
    values = gtsam.Values()
    values.insert(0, np.array([8.0]))
    np.testing.assert_allclose(factor.whitenedError(values), [4.0, 2.0])


def test_arrays_in_any_layout_are_taken():
    """Slices and transposed arrays are not contiguous, and integers not floats."""
    wide = np.arange(12).reshape(2, 6)
    factor = linear_factor(derivatives=[wide[:, ::2], wide.T[3][:, None]])
    jacobian, _ = factor.linearize(some_values()).jacobian()
    np.testing.assert_array_equal(jacobian, [[0, 2, 4, 3], [6, 8, 10, 9]])


def test_an_error_alone_needs_no_derivatives():
    factor = linear_factor(derivatives=None)
    assert np.isfinite(factor.error(some_values()))


def test_the_function_is_checked_every_time():
    calls = []

    def function(vectors, _):
        calls.append(1)
        columns = 3 if len(calls) < 3 else 2
        return vectors[0][:1], [np.ones((1, columns))]

    factor = vector_factor([0], [3], 1, function)
    factor.linearize(some_values())
    factor.linearize(some_values())
    with pytest.raises(FactorError, match=r"shapes \[\(1, 2\)\]; expected \(1,\) and \[\(1, 3\)\]"):
        factor.linearize(some_values())


# What a function may get wrong; a bare CustomFactor crashes on most of these.
WRONG = {
    "missing": "[J0]",
    "none": "[J0, None]",
    "too many": "[J0, J1, J1]",
    "empty": "[]",
    "one-dimensional": "[J0, J1[:, 0]]",
    "rows": "[J0, np.ones((3, 1))]",
    "columns": "[np.ones((2, 4)), J1]",
    "transposed": "[J0.T, J1]",
    "nothing": "[np.empty((0, 0)), J1]",
    "three-dimensional": "[J0[None], J1]",
    "nan": "[J0 * np.nan, J1]",
    "infinite": "[J0, J1 / 0.0]",
    "text": "['a', J1]",
    "swapped": "[J1, J0]",
}
ERRORS = {
    "short": "np.ones(1)",
    "long": "np.ones(3)",
    "matrix": "np.ones((2, 1))",
    "scalar": "np.float64(1.0)",
    "nan": "np.array([np.nan, 0.0])",
    "infinite": "np.array([np.inf, 0.0])",
}

PROGRAM = """
import warnings

import gtsam
import numpy as np
from geograph.factors import FactorError, vector_factor

warnings.simplefilter("ignore")
J0, J1 = np.ones((2, 3)), np.ones((2, 1))
values = gtsam.Values()
values.insert(0, np.ones(3))
values.insert(1, np.ones(1))

def attempt(name, error, derivatives, good_calls):
    calls = []

    def function(vectors, jacobian):
        calls.append(1)
        if len(calls) <= good_calls:
            return np.ones(2), [J0, J1]
        return error(), derivatives()

    graph = gtsam.NonlinearFactorGraph()
    graph.push_back(vector_factor([0, 1], [3, 1], 2, function))
    try:
        for _ in range(good_calls + 1):
            graph.linearize(values)
    except (FactorError, ValueError, TypeError) as fault:
        print("caught", name, type(fault).__name__)
    else:
        print("missed", name)
"""


@pytest.mark.parametrize("good_calls", [0, 1])
def test_the_interpreter_survives_whatever_a_function_returns(good_calls):
    lines = [textwrap.dedent(PROGRAM)]
    for name, code in WRONG.items():
        lines.append(f"attempt({name!r}, lambda: np.ones(2), lambda: {code}, {good_calls})")
    for name, code in ERRORS.items():
        lines.append(f"attempt('e-{name}', lambda: {code}, lambda: [J0, J1], {good_calls})")
    lines.append("print('alive')")
    done = subprocess.run(
        [sys.executable, "-c", "\n".join(lines)], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    output = done.stdout.splitlines()
    assert output[-1] == "alive"
    assert not [line for line in output if line.startswith("missed")]
    # What is not even numbers fails in NumPy's own words.
    plain = {line.split()[1] for line in output if line.endswith(("ValueError", "TypeError"))}
    assert plain == {"text"}
    assert len(output) == len(WRONG) + len(ERRORS) + 1


@pytest.mark.parametrize("code", ["np.ones(1)", "np.ones(3)", "np.ones((2, 1))"])
def test_an_error_of_the_wrong_shape_alone(code):
    factor = linear_factor(error=eval(code))
    with pytest.raises(FactorError, match=r"error has shape .*; expected \(2,\)"):
        factor.error(some_values())


def test_errors_of_the_function_come_through():
    def function(*_):
        raise KeyError("from within")

    factor = vector_factor([0], [3], 1, function)
    with pytest.raises(KeyError, match="from within"):
        factor.error(some_values())


def test_the_optimiser_stops_at_an_error_that_is_not_finite():
    """GTSAM itself would return the first guess as if it were the answer."""

    def function(vectors, _):
        return np.log(np.maximum(vectors[0], 0.0)) if vectors[0][0] > 0 else vectors[0] * np.nan, [
            1.0 / vectors[0][None]
        ]

    graph = gtsam.NonlinearFactorGraph()
    graph.push_back(vector_factor([0], [1], 1, function))
    values = gtsam.Values()
    values.insert(0, np.array([10.0]))
    with pytest.raises(FactorError, match="not finite; check the values"):
        gtsam.GaussNewtonOptimizer(graph, values).optimize()


@settings(max_examples=50, deadline=None, derandomize=True)
@given(
    st.integers(1, 4),
    st.lists(st.integers(1, 5), min_size=1, max_size=3),
    st.data(),
)
def test_only_the_promised_shapes_pass(rows, sizes, data):
    shapes = data.draw(
        st.lists(
            st.tuples(st.integers(1, 5), st.integers(1, 5)),
            min_size=len(sizes),
            max_size=len(sizes),
        )
    )
    factor = vector_factor(
        range(len(sizes)), sizes, rows, lambda *_: (np.ones(rows), [np.ones(s) for s in shapes])
    )
    values = gtsam.Values()
    for key, size in enumerate(sizes):
        values.insert(key, np.ones(size))
    if shapes == [(rows, size) for size in sizes]:
        factor.linearize(values)
    else:
        with pytest.raises(FactorError, match="derivatives of shapes"):
            factor.linearize(values)
