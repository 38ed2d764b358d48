"""What every test relies on: the CPU, a cache of what was compiled, the same random examples in every run, `--full`."""

import gc
import os
import pathlib
import tempfile

os.environ["JAX_PLATFORMS"] = "cpu"
# What one test, worker or process compiled, the others load: every `Run` has functions of its own under ``jit``.
# Workers inherit the folder; who names one keeps it for the next run of the tests.
if "JAX_COMPILATION_CACHE_DIR" not in os.environ:
    _cache = tempfile.TemporaryDirectory()
    os.environ["JAX_COMPILATION_CACHE_DIR"] = _cache.name
os.environ["JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS"] = "0.3"

import jax
import pytest
from hypothesis import settings
from jax._src import compiler

# Most tests compile for longer than they run, so XLA is asked for few optimisations, also in processes that they start.
# Those that run for long have them all, and those that compare with other people's numbers: what users run is tested.
OPTIMISED = (
    "agents/test_hsac_closed_form.py", "agents/test_scripted.py", "agents/test_torch.py", "test_talk.py",
    "training/test_randomise.py", "world/test_lidar_mujoco.py", "world/test_rvo2.py",
)  # fmt: skip

# Half of the time of compiling goes into kernels that are written through MLIR instead of straight in LLVM's language,
# and into cutting programs up for threads, where all cores are busy anyway.
PLAINLY = {"xla_cpu_use_fusion_emitters": False, "xla_cpu_parallel_codegen_split_count": 1}
try:
    jax.jit(lambda: 0, compiler_options=PLAINLY)()
except jax.errors.JaxRuntimeError:  # of an XLA that has no such options any more
    PLAINLY = {}
XLA_FLAGS = os.environ.get("XLA_FLAGS", "")

# Tracing makes objects by the million, of which few are garbage: looking for it takes a tenth of the time otherwise.
gc.set_threshold(200_000, 50, 50)

settings.register_profile("jaxnav", derandomize=True, deadline=None, max_examples=100, database=None)
settings.load_profile("jaxnav")


def pytest_addoption(parser):
    parser.addoption("--full", action="store_true", help="proofs at their full size instead of a twentieth of it")


def _compile_options(*args, options_of=compiler.get_compile_options, **kwargs):
    """What XLA is asked for in this process, where it read XLA_FLAGS once and for all."""
    options = options_of(*args, **kwargs)
    if os.environ.get("JAX_DISABLE_MOST_OPTIMIZATIONS") == "1":
        options.env_option_overrides = [*options.env_option_overrides, *PLAINLY.items()]
    return options


compiler.get_compile_options = _compile_options


@pytest.hookimpl(tryfirst=True)  # before fixtures of any scope
def pytest_runtest_setup(item):
    quickly = item.path.relative_to(pathlib.Path(__file__).parent).as_posix() not in OPTIMISED
    jax.config.update("jax_disable_most_optimizations", quickly)
    os.environ["JAX_DISABLE_MOST_OPTIMIZATIONS"] = str(int(quickly))
    flags = [f"--{name}={value}".lower() for name, value in PLAINLY.items()] if quickly else []
    os.environ["XLA_FLAGS"] = " ".join([XLA_FLAGS, *flags])


@pytest.fixture(scope="session")
def full(request):
    """Whether proofs run at their full size."""
    return request.config.getoption("--full")
