"""The state that the first solution is expanded about."""

import warnings

import numpy as np
from numpy.polynomial.hermite_e import hermegauss
from scipy.linalg import solve_continuous_lyapunov

from averaging.phase_space.equation.frame import Frame, Reference, gibbs_reference, with_moments

ROUNDS, CLOSE = 40, 1e-3
"""Most linear systems, each with the contact force of the Gaussian state before, and the relative
change of the variance of the contact displacement that ends them: it is only a start."""
POINTS = 80
"""Gauss points of the means over that state."""


def start(frame: Frame) -> Reference:
    """Return the Gaussian state of the linear system that is nearest to a frame's.

    Statistical linearisation (Roberts and Spanos, Random Vibration and Statistical Linearization,
    1990): the contact force g(y) is E g + k (y − E y), k = E g'(y) = E g (y − E y)/Var y, of the
    Gaussian y that this force makes. Its temperatures are near those of the solution however unlike
    damping and noise of the masses are; in proportion it is the Gibbs state but for y, whose weight
    has the force itself. With damping terms it is the Gibbs state at which they balance the noise.
    Raises ``NotApplicable`` where nothing is damped or no noise acts, and ``LinAlgError`` where the
    linear system has no stationary state.
    """
    gibbs, n = gibbs_reference(frame), frame.n
    if frame.system.damping_terms:
        return gibbs
    x, weight = hermegauss(POINTS)
    weight /= weight.sum()
    centre, variance = 0.0, 1.0 / gibbs.weight[1]
    noise = np.zeros((2 * n, 2 * n))
    noise[n:, n:] = 2.0 * frame.noise
    for _ in range(ROUNDS):
        y = centre + np.sqrt(variance) * x
        force = frame.contact_force(y)
        k = float(weight @ (force * (y - centre))) / variance
        stiffness = frame.stiffness.copy()
        stiffness[0, 0] += k
        drift = np.block([[np.zeros((n, n)), np.eye(n)], [-stiffness, -frame.damping]])
        with warnings.catch_warnings():
            # Where a motion is not damped at all; the answer is then of no distribution.
            warnings.simplefilter("ignore", RuntimeWarning)
            covariance = solve_continuous_lyapunov(drift, -noise)
        means = np.linalg.solve(stiffness, (k * centre - float(weight @ force)) * np.eye(n)[0])
        if not covariance[0, 0] > 0.0:
            raise np.linalg.LinAlgError("the linear system has no stationary state")
        if abs(covariance[0, 0] - variance) <= CLOSE * variance:
            break
        # Halfway, as a softer stop lets y out to where it is stiffer.
        centre, variance = 0.5 * (centre + means[0]), 0.5 * (variance + covariance[0, 0])
    # Of mirror images round-off is all that the means are.
    mean = np.zeros(2 * n) if frame.symmetric else np.concatenate([means, np.zeros(n)])
    return with_moments(frame, mean, covariance)
