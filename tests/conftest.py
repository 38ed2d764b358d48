"""What every test relies on: the CPU, a cache of what was compiled, the same random examples in every run, `--full`."""

import gc
import os
import pathlib
import tempfile

os.environ["JAX_PLATFORMS"] = "cpu"
# What one test, worker or process compiled, the others load: every `Run` has functions of its own under ``jit``.
if "PYTEST_XDIST_WORKER" not in os.environ:  # workers inherit the folder
    _cache = tempfile.TemporaryDirectory()
    os.environ["JAX_COMPILATION_CACHE_DIR"] = _cache.name
os.environ["JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS"] = "0.3"

import jax
import pytest
from hypothesis import settings

# Most tests compile for longer than they run, so XLA is asked for few optimisations, also in processes that they start.
# Those that run for long have them all, and those that compare with other people's numbers: what users run is tested.
OPTIMISED = (
    "agents/test_hsac_closed_form.py", "agents/test_scripted.py", "agents/test_torch.py", "test_notebooks.py",
    "test_readme.py", "test_talk.py", "world/test_lidar_mujoco.py", "world/test_rvo2.py",
)  # fmt: skip

# Tracing makes objects by the million, of which few are garbage: looking for it takes a tenth of the time otherwise.
gc.set_threshold(200_000, 50, 50)

settings.register_profile("jaxnav", derandomize=True, deadline=None, max_examples=100, database=None)
settings.load_profile("jaxnav")


def pytest_addoption(parser):
    parser.addoption("--full", action="store_true", help="proofs at their full size instead of a twentieth of it")


@pytest.hookimpl(tryfirst=True)  # before fixtures of any scope
def pytest_runtest_setup(item):
    quickly = item.path.relative_to(pathlib.Path(__file__).parent).as_posix() not in OPTIMISED
    jax.config.update("jax_disable_most_optimizations", quickly)
    os.environ["JAX_DISABLE_MOST_OPTIMIZATIONS"] = str(int(quickly))


@pytest.fixture(scope="session")
def full(request):
    """Whether proofs run at their full size."""
    return request.config.getoption("--full")
