"""jaxnav: a differentiable 2D social-navigation world and a robot in it that learns to steer and to talk."""

from .world import Action, Params, World, WorldConfig

__version__ = "0.1.0"

__all__ = ["Action", "Params", "World", "WorldConfig"]
