"""What every test relies on: the CPU, property tests that draw the same examples in every run, and `--full`."""

import os

os.environ["JAX_PLATFORMS"] = "cpu"

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
