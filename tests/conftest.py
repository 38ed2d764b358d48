"""What every test relies on: the CPU, a cache of what was compiled, the same random examples in every run, `--full`."""

import os
import tempfile

os.environ["JAX_PLATFORMS"] = "cpu"
# What one test, worker or process compiled, the others load: every `Run` has functions of its own under ``jit``.
if "PYTEST_XDIST_WORKER" not in os.environ:  # workers inherit the folder
    _cache = tempfile.TemporaryDirectory()
    os.environ["JAX_COMPILATION_CACHE_DIR"] = _cache.name
os.environ["JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS"] = "0.3"

import pytest
from hypothesis import settings

settings.register_profile("jaxnav", derandomize=True, deadline=None, max_examples=100, database=None)
settings.load_profile("jaxnav")


def pytest_addoption(parser):
    parser.addoption("--full", action="store_true", help="proofs at their full size instead of a twentieth of it")


@pytest.fixture(scope="session")
def full(request):
    """Whether proofs run at their full size."""
    return request.config.getoption("--full")
