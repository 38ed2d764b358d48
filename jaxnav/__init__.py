"""jaxnav: a differentiable 2D social-navigation world and a robot in it that learns to steer and to talk."""

from .world import SCENES, SUITES, Action, Params, Scene, World, WorldConfig, default_params

__version__ = "0.1.0"

__all__ = ["SCENES", "SUITES", "Action", "Params", "Scene", "World", "WorldConfig", "default_params"]
