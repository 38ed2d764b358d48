"""Figures of a run, drawn with matplotlib. No pyplot: no window system, and no state shared between callers."""

from .curve_figure import learning_curve
from .trajectory_figure import trajectories

__all__ = ["learning_curve", "trajectories"]
