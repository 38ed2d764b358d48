"""jaxnav: a differentiable 2D social-navigation world and a robot in it that learns to steer and to talk."""

from .world import Action, Params, World, WorldConfig

__all__ = ["Action", "Params", "World", "WorldConfig"]
