"""A tolerance of 0, below it or of no number is refused by every question, and not the default."""

import numpy as np
import pytest

from averaging import Exact, Integrable, Linear, NonIntegrable, PhaseSpace
from fpk import System
from fpk.answer.names import REST, parse_limit, parse_observable
from fpk.numeric.errors import InvalidInput
from sim import MonteCarlo

FREE = System([1.0], [1.0], [0.1], [0.05])
Q, TIMES, AT = parse_observable("q1", 1), np.array([1.0]), np.array([0.5])
QUESTIONS = {
    "crossings": (Q, AT),
    "spectrum": (Q, AT),
    "correlation": (Q, AT),
    "relaxation": (2,),
    "passage": (parse_limit("H=1", 1), REST, TIMES),
    "transient": (Q, REST, TIMES, (AT,)),
}
METHODS = (
    Exact(), Linear(), Integrable(), Integrable("fem"), NonIntegrable(), PhaseSpace(), MonteCarlo(),
)  # fmt: skip
ASKED = [(m, q) for m in METHODS for q in QUESTIONS if hasattr(m, q)]


@pytest.mark.parametrize(("method", "question"), ASKED)
@pytest.mark.parametrize("tol", [0.0, -1e-3, np.nan])
def test_no_such_tolerance(method, question, tol):
    with pytest.raises(InvalidInput, match="tol"):
        getattr(method, question)(FREE, *QUESTIONS[question], tol=tol)
