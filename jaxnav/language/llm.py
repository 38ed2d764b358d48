"""A language model behind any OpenAI-compatible server: answers that come in time, or not at all.

Nothing here ever blocks the loop that controls the robot: a question is put by a thread, and the loop looks whether the
answer is there.
"""

import concurrent.futures
import logging
import os
import threading
import time
from collections.abc import Callable
from typing import Any, Generic, TypeVar

from ..errors import UserError

LIMIT = 1.5  # seconds for an answer
_AT_ONCE = 2  # questions under way; with more, a server that hangs would collect threads
_PATIENCE = 10  # time limits after which a question that hangs no longer counts as under way
_ANSWER = 100  # tokens
log = logging.getLogger("jaxnav.language")
T = TypeVar("T")


class Answered(Generic[T]):
    """An answer that is there already, used like `Asked`."""

    def __init__(self, value: T) -> None:
        self._value = value

    def take(self) -> T:
        """The answer."""
        return self._value

    def wait(self) -> T:
        """The answer."""
        return self._value


class Asked(Generic[T]):
    """An answer that is on its way. `take` gives it without waiting, or the fallback once its time is over.

    future:   of the raw answer.
    accept:   raw answer -> value, or ValueError.
    fallback: () -> value.
    what:     a name for the log.
    limit:    seconds.
    keep:     called with an accepted value.
    """

    def __init__(
        self,
        future: concurrent.futures.Future[Any],
        accept: Callable[[Any], T],
        fallback: Callable[[], T],
        what: str,
        limit: float,
        keep: Callable[[T], object],
    ) -> None:
        self._future, self._accept, self._fallback = future, accept, fallback
        self._what, self._limit, self._keep = what, limit, keep
        self._deadline = time.monotonic() + limit
        self._value: T | None = None

    def take(self) -> T | None:
        """The answer, or None while it may still come."""
        if self._value is None:
            if self._future.done():
                self._value = self._judge()
            elif time.monotonic() >= self._deadline:
                self._value = self._give_up(f"no answer within {self._limit:g} s")
        return self._value

    def wait(self) -> T:
        """The answer, when it is there or its time is over."""
        while (value := self.take()) is None:
            concurrent.futures.wait([self._future], timeout=max(0.0, self._deadline - time.monotonic()))
        return value

    def _judge(self) -> T:
        try:
            value = self._accept(self._future.result())
        except ValueError as reason:
            return self._give_up(reason)
        except Exception as error:  # whatever the client raises: no answer may end the loop
            return self._give_up(f"{type(error).__name__}: {error}")
        self._keep(value)
        return value

    def _give_up(self, reason: object) -> T:
        log.warning("%s: %s; falling back", self._what, " ".join(str(reason).split())[:160])
        return self._fallback()


class LanguageModel:
    """A chat model; `ask` puts a question to it in a thread of its own.

    base_url, model, key: of the server; limit: seconds for an answer.
    """

    def __init__(self, base_url: str, model: str, key: str, limit: float = LIMIT) -> None:
        try:
            import openai
        except ImportError:
            raise UserError('the client of language models is not installed: pip install "jaxnav[language]"') from None
        self._client = openai.OpenAI(base_url=base_url, api_key=key, timeout=limit, max_retries=0)
        self._model, self._limit = model, limit
        self._under_way: list[tuple[float, concurrent.futures.Future]] = []  # (when it is given up, future)
        # The first request imports and builds a good deal: not while the robot drives.
        _ = self._client.chat.completions

    @classmethod
    def from_environment(cls) -> "LanguageModel":
        """The one that OPENAI_BASE_URL, OPENAI_MODEL and OPENAI_API_KEY name; UserError says which is missing."""
        names = ("OPENAI_BASE_URL", "OPENAI_MODEL", "OPENAI_API_KEY")
        missing = [name for name in names if not os.environ.get(name)]
        if missing:
            raise UserError(f"{', '.join(missing)} not set: name an OpenAI-compatible server, its model and its key")
        return cls(os.environ["OPENAI_BASE_URL"], os.environ["OPENAI_MODEL"], os.environ["OPENAI_API_KEY"])

    def ask(
        self,
        system: str,
        question: str,
        accept: Callable[[Any], T],
        fallback: Callable[[], T],
        what: str,
        keep: Callable[[T], object],
    ) -> Asked[T] | Answered[T]:
        """`Asked` about a question, or `Answered` with the fallback while too many questions are under way."""
        now = time.monotonic()
        self._under_way = [(until, future) for until, future in self._under_way if until > now and not future.done()]
        if len(self._under_way) >= _AT_ONCE:
            log.warning("%s: the language model is busy; falling back", what)
            return Answered(fallback())
        future: concurrent.futures.Future[Any] = concurrent.futures.Future()
        self._under_way.append((now + _PATIENCE * self._limit, future))
        # A daemon: a server that never ends its answer must not keep the process from ending.
        threading.Thread(target=self._complete, args=(future, system, question), daemon=True).start()
        return Asked(future, accept, fallback, what, self._limit, keep)

    def _complete(self, future: concurrent.futures.Future[Any], system: str, question: str) -> None:
        try:
            answer = self._client.chat.completions.create(
                model=self._model, max_tokens=_ANSWER, temperature=0.7,
                messages=[{"role": "system", "content": system}, {"role": "user", "content": question}],
            )  # fmt: skip
            future.set_result(answer.choices[0].message.content)
        except Exception as error:  # raised again where the answer is taken
            future.set_exception(error)
