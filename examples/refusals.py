"""
What is refused, and how
========================

A request that cannot be answered ends in one line that says why; nothing else comes back.
"""

import numpy as np

import fpk
from averaging import PhaseSpace
from fpk.answer.names import REST, parse_limit

stop = fpk.Contact(mass=2, side="right", stiffness=10.0, clearance=0.5)
system = fpk.System([1, 1], [1, 1], [0.08, 0.04], [0.01, 0.02], contacts=(stop,))


def refused(error, **request):
    """Check that the request is refused with ``error``, in one line."""
    try:
        fpk.solve(system, request.pop("observables", ["q2"]), **request)
    except error as reason:
        print(f"{error.__name__}: {reason}")
        assert "\n" not in str(reason)
    else:
        raise AssertionError(f"{request} was answered")


refused(fpk.NotApplicable, methods=["exact"])  # damping and noise are not in proportion
refused(fpk.NotApplicable, methods=["linear"])  # there is a contact
refused(fpk.NotApplicable, observables=["H1"], methods=["nonintegrable"])
refused(fpk.InvalidInput, methods=["exakt"])
refused(fpk.InvalidInput, observables=["q0"])  # masses count from 1
refused(fpk.InvalidInput, observables=["q3"])
refused(fpk.InvalidInput, methods=["nonintegrable"], tol=1e-13)  # double precision has no more

# %%
# What could not be certified is no answer either: that this energy is ever passed is less probable
# than the full equation can be solved for.

one = fpk.System([1], [1], [0.1], [0.05], contacts=(fpk.Contact(1, "both", 10.0, 0.5),))
try:
    PhaseSpace().passage(one, parse_limit("H=40", 1), REST, np.array([]))
except fpk.NotCertified as reason:
    print(f"NotCertified: {reason}")
else:
    raise AssertionError("it was answered")
