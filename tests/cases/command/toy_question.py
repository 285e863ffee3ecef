"""A question of one's own about motion in time: the variance of q(t) − q(0), with its answer."""

from dataclasses import replace

import numpy as np

from averaging import Linear
from fpk.answer.dynamics import Curve
from fpk.answer.question import Asked, Question, answer, register_question, require_lags

INCREMENT = register_question(
    Question(
        name="increment",
        words="variance of an increment",
        key="variance",
        help="Give the variance of q(t) − q(0) at lags t >= 0.",
        axis="lag",
        powers=((0, 0, 1), (2, 0, 0)),
        scale=lambda q, v: 2.0 * q**2,
        check=require_lags,
    )
)


def increment(method: Linear, asked: Asked) -> Curve:
    """Return 2 (C(0) − C(t)) from the autocovariance C."""
    lags = np.append(0.0, asked.at)
    half = None if asked.tol is None else 0.5 * asked.tol  # two errors of C in one of the answer
    C = method.correlation(asked.system, asked.observable, lags, tol=half)
    values, errors = 2.0 * (C.values[0] - C.values[1:]), 2.0 * (C.errors[0] + C.errors[1:])
    return replace(C, values=values, errors=errors)


Linear.increment = answer(increment)
