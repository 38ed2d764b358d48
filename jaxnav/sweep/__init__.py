"""Sweeps: many learners trained at once in populations, the worst stopped early, the best confirmed on fresh seeds."""

from .spec import Guard, Range, Sweep, mean_success, worst_success

__all__ = ["Guard", "Range", "Sweep", "mean_success", "worst_success"]
