"""Probability of rare failure by adaptive multilevel splitting of the full equation.

``rare_failure`` compiles and simulates; ``Splitting`` holds its settings, ``RareFailure`` is what
it returns.
"""

from sim.questions.splitting.run import RareFailure, Splitting, rare_failure

__all__ = ["RareFailure", "Splitting", "rare_failure"]
