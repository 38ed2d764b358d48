"""A server to talk with."""

import importlib.util
import pathlib

import pytest

# By its path: tests are no package, and benchmarks/speaker.py uses it too.
_spec = importlib.util.spec_from_file_location("stub_server", pathlib.Path(__file__).parent / "stub_server.py")
stub_server = importlib.util.module_from_spec(_spec)
_spec.loader.exec_module(stub_server)


@pytest.fixture(name="good_answer")
def _good_answer():
    return stub_server.good_answer


@pytest.fixture
def stub():
    """Starts a `Stub` with a function that answers."""
    started = []

    def start(answer):
        started.append(stub_server.Stub(answer))
        return started[-1]

    yield start
    for server in started:
        server.close()
