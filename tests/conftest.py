"""What every test relies on: the CPU, and property tests that draw the same examples in every run."""

import os

os.environ["JAX_PLATFORMS"] = "cpu"

from hypothesis import settings

settings.register_profile("jaxnav", derandomize=True, deadline=None, max_examples=100, database=None)
settings.load_profile("jaxnav")
