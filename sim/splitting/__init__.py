"""Probability of rare failure by adaptive multilevel splitting, of the full and averaged equation.

``rare_failure`` and ``rare_failure_of_process`` compile and simulate; ``Splitting`` holds their
settings, ``RareFailure`` is what they return.
"""

from sim.splitting.run import rare_failure, rare_failure_of_process
from sim.splitting.settings import RareFailure, Splitting

__all__ = ["RareFailure", "Splitting", "rare_failure", "rare_failure_of_process"]
