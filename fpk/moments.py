"""Moments of Gaussian variables, from which microcanonical and Gibbs averages follow."""

from functools import cache

from fpk.arrays import Array


def gaussian_moment(covariance: Array, powers: tuple[int, ...]) -> float:
    """Return E Π x_a^powers[a] of x ~ N(0, covariance), shape (n, n), by Isserlis' theorem.

    Integration by parts, ``E x_a f = Σ_b cov_ab E ∂f/∂x_b``, leads from one monomial to others two
    degrees lower. It is 0 where the total power is odd.
    """

    @cache
    def moment(powers: tuple[int, ...]) -> float:
        total = sum(powers)
        if total % 2:
            return 0.0
        if total == 0:
            return 1.0
        a = next(i for i, power in enumerate(powers) if power)
        rest = _lowered(powers, a)
        return sum(
            float(covariance[a, b]) * power * moment(_lowered(rest, b))
            for b, power in enumerate(rest)
            if power
        )

    return moment(tuple(powers))


def _lowered(powers: tuple[int, ...], index: int) -> tuple[int, ...]:
    return tuple(power - (i == index) for i, power in enumerate(powers))
