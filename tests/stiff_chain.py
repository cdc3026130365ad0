"""A stiff chain solved to 60 digits, by the library, and in the states themselves.

One axis of an object under white noise on the jerk; its position is measured with unit sigma at
every second, by a sensor with a bias. The smaller the noise, the stiffer the chain.
"""

from decimal import Decimal, localcontext

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from geograph.blocks import Sums
from geograph.eliminate import Elimination, LinearSystem
from geograph.factors.kinematics import noise_square_root, transition

SIZE = 3
BIAS_SIGMA = 3.0
START_SIGMA = np.array([1e3, 1e2, 1e1])


def measured(knots):
    """Residuals of the measurements at the linearisation point."""
    return np.random.default_rng(0).normal(size=knots)


def structured(knots, noise):
    """Return the library's solution and marginals."""
    d = SIZE
    blocks = np.zeros((knots - 1, 2 * d + 2, 2 * d + 2))
    for k, residual in enumerate(measured(knots)):
        row = np.zeros(2 * d + 2)
        row[[0 if k + 1 < knots else d, 2 * d, -1]] = 1.0, BIAS_SIGMA, residual
        blocks[min(k, knots - 2)] += np.outer(row, row)
    count = knots - 1
    system = LinearSystem(
        blocks=Sums.of(blocks, 2 * d),
        inverse_transition=np.repeat(transition(d, -1.0)[None], count, axis=0),
        noise_root=np.repeat(noise * noise_square_root(d, 1.0)[None], count, axis=0),
        noise_residual=np.zeros((count, d)),
        prior_information=START_SIGMA**-2,
        prior_gradient=np.zeros(d),
        constants=np.zeros(1),
        cost=0.0,
    )
    elimination = Elimination(system)
    return elimination.solve().knots, elimination.marginals().knots


def whitened_rows(knots, noise):
    """Return all rows and right-hand sides in the states, and where each row begins."""
    d = SIZE
    columns = d * knots + 1
    white = np.linalg.inv(noise * noise_square_root(d, 1.0))
    rows, right = [], []
    start = np.zeros((d, columns))
    start[:, :d] = np.diag(1.0 / START_SIGMA)
    bias = np.zeros((1, columns))
    bias[0, -1] = 1.0
    rows += [start, bias]
    right += [np.zeros(d), np.zeros(1)]
    for k, residual in enumerate(measured(knots)):
        row = np.zeros((1, columns))
        row[0, d * k], row[0, -1] = 1.0, BIAS_SIGMA
        rows.append(row)
        right.append(np.array([-residual]))
        if k + 1 < knots:
            both = np.zeros((d, columns))
            both[:, d * k : d * k + d] = -white @ transition(d, 1.0)
            both[:, d * k + d : d * k + 2 * d] = white
            rows.append(both)
            right.append(np.zeros(d))
    return np.concatenate(rows), np.concatenate(right)


def diagonal_blocks(covariance, knots):
    d = SIZE
    return np.stack([covariance[d * k : d * k + d, d * k : d * k + d] for k in range(knots)])


def in_information_form(knots, noise):
    """Solve by the information matrix of the states and its Cholesky factor."""
    rows, right = whitened_rows(knots, noise)
    factor = cho_factor(rows.T @ rows, lower=True)
    covariance = cho_solve(factor, np.eye(rows.shape[1]))
    state = cho_solve(factor, rows.T @ right)[:-1].reshape(knots, SIZE)
    return state, diagonal_blocks(covariance, knots)


def by_orthogonal_triangle(knots, noise):
    """Solve by a QR factorisation of the whitened rows of the states."""
    rows, right = whitened_rows(knots, noise)
    q, r = np.linalg.qr(rows)
    inverse = np.linalg.inv(r)
    state = (inverse @ (q.T @ right))[:-1].reshape(knots, SIZE)
    return state, diagonal_blocks(inverse @ inverse.T, knots)


def exactly(knots, noise):
    """Filter and smooth (Rauch, Tung, Striebel) in decimal arithmetic of 60 digits."""
    with localcontext() as context:
        context.prec = 60
        phi, root = exact(np.eye(4)), exact(np.zeros((4, 4)))
        phi[:3, :3] = exact(transition(3, 1.0))
        root[:3, :3] = exact(noise * noise_square_root(3, 1.0))
        added = root @ root.T
        look = exact([[1.0, 0.0, 0.0, BIAS_SIGMA]])
        mean, covariance = exact(np.zeros((4, 1))), exact(np.diag([*START_SIGMA**2, 1.0]))
        filtered, predicted = [], []
        for k, residual in enumerate(measured(knots)):
            if k:
                mean, covariance = phi @ mean, phi @ covariance @ phi.T + added
            predicted.append((mean, covariance))
            gain = covariance @ look.T / ((look @ covariance @ look.T)[0, 0] + 1)
            mean = mean + gain * (-Decimal(float(residual)) - (look @ mean)[0, 0])
            covariance = covariance - gain @ look @ covariance
            filtered.append((mean, covariance))
        smoothed = [filtered[-1]]
        for k in range(knots - 2, -1, -1):
            mean, covariance = filtered[k]
            ahead_mean, ahead = predicted[k + 1]
            gain = covariance @ phi.T @ inverse(ahead)
            later_mean, later = smoothed[-1]
            smoothed.append(
                (
                    mean + gain @ (later_mean - ahead_mean),
                    covariance + gain @ (later - ahead) @ gain.T,
                )
            )
        smoothed.reverse()
        state = np.array([m[:3, 0] for m, _ in smoothed]).astype(np.float64)
        return state, np.array([c[:3, :3] for _, c in smoothed]).astype(np.float64)


def exact(array):
    """Return an array of Decimals, equal to the floats."""
    floats = np.asarray(array, dtype=np.float64)
    return np.array([Decimal(x) for x in floats.ravel().tolist()]).reshape(floats.shape)


def inverse(matrix):
    """Invert a matrix of Decimals by Gauss-Jordan elimination with pivoting."""
    size = matrix.shape[0]
    work = np.concatenate([matrix, exact(np.eye(size))], axis=1)
    for column in range(size):
        pivot = column + int(np.argmax([abs(x) for x in work[column:, column]]))
        work[[column, pivot]] = work[[pivot, column]]
        work[column] = work[column] / work[column, column]
        for row in range(size):
            if row != column:
                work[row] = work[row] - work[row, column] * work[column]
    return work[:, size:]


def errors(found, truth):
    """Return the worst error of the estimate in sigmas, and of a covariance relative to it."""
    state, covariance = found
    true_state, true_covariance = truth
    sigma = np.sqrt(np.einsum("kii->ki", true_covariance))
    spread = sigma[:, :, None] * sigma[:, None, :]
    return (
        float(np.max(np.abs(state - true_state) / sigma)),
        float(np.max(np.abs(covariance - true_covariance) / spread)),
    )
