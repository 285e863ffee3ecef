"""Probability of rare failure by adaptive multilevel splitting of the full equation."""

from sim.questions.splitting.run import RareFailure, Splitting, rare_failure

__all__ = ["RareFailure", "Splitting", "rare_failure"]
