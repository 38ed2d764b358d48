"""Stopping on request: signals are noted, so that a checkpoint is saved before the program ends."""

import contextlib
import signal
import threading
from collections.abc import Iterator


class Interrupted(Exception):
    """Training stopped on request; a checkpoint is saved. ``signal`` is the signal's number."""

    def __init__(self, number: int):
        self.signal = number


class Stop:
    """The signal that came, None before one."""

    number: int | None = None


@contextlib.contextmanager
def stop_signals() -> Iterator[Stop]:
    """Note SIGINT and SIGTERM instead of dying of them; a second one has its usual effect."""
    stop, before = Stop(), {}
    if threading.current_thread() is not threading.main_thread():
        yield stop  # only the main thread may handle signals
        return

    def note(number, frame):
        stop.number = number
        signal.signal(number, before[number])

    for number in (signal.SIGINT, signal.SIGTERM):
        before[number] = signal.signal(number, note)
    try:
        yield stop
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
