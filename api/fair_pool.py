"""Threads that take work in turns over those who ask, so that one caller's queue does not delay another's.

Fair queuing as by Nagle, RFC 970: a queue for each caller, served round robin.
"""

from __future__ import annotations

import threading
import time
from collections import OrderedDict, deque
from collections.abc import Callable
from concurrent.futures import Future
from dataclasses import dataclass, field
from typing import Any, TypeVar

_R = TypeVar("_R")

_RECENT_S = 10.0
"""Who has called in this time shares the threads."""


@dataclass
class _Caller:
    waiting: deque[tuple[Future[Any], Callable[[], Any]]] = field(default_factory=deque)
    running: int = 0


class FairPool:
    """Threads for blocking work, shared round robin over callers; one caller never has them all.

    A caller alone may hold all threads but one, so that another's next call begins at once. While others call, too, its
    share is smaller: there are twice as many threads as cores, and calls that compute are faster side by side only as
    long as each has a core.

    Args:
        size: threads, at least one.
        name: prefix of the threads' names.
        clock: seconds.
    """

    def __init__(self, size: int, name: str, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._called: dict[str, float] = {}
        self._callers: OrderedDict[str, _Caller] = OrderedDict()
        self._changed = threading.Condition()
        self._closed = False
        self._size = size
        self._name = name
        self._threads: list[threading.Thread] = []

    def submit(self, caller: str, function: Callable[[], _R]) -> Future[_R]:
        """Queue a call; its future can be cancelled as long as it waits.

        Raises:
            RuntimeError: the pool is closed.
        """
        future: Future[_R] = Future()
        with self._changed:
            if self._closed:
                raise RuntimeError("the pool is closed")
            self._callers.setdefault(caller, _Caller()).waiting.append((future, function))
            self._called[caller] = self._clock()
            self._changed.notify_all()
            if len(self._threads) < self._size:  # a pool that nobody uses has no threads
                thread = threading.Thread(target=self._work, name=f"{self._name}_{len(self._threads)}", daemon=True)
                self._threads.append(thread)
                thread.start()
        future.add_done_callback(lambda done: self._drop(caller, done) if done.cancelled() else None)
        return future

    def close(self) -> None:
        """Wait for what runs, cancel what waits."""
        with self._changed:
            self._closed = True
            waiting = [future for caller in self._callers.values() for future, _ in caller.waiting]
            self._changed.notify_all()
        for future in waiting:
            future.cancel()
        for thread in self._threads:
            thread.join()

    def _work(self) -> None:
        while (taken := self._take()) is not None:
            name, future, function = taken
            try:
                if future.set_running_or_notify_cancel():
                    try:
                        result = function()
                    except BaseException as error:
                        future.set_exception(error)
                    else:
                        future.set_result(result)
                    del function
            finally:
                self._done(name)

    def _take(self) -> tuple[str, Future[Any], Callable[[], Any]] | None:
        """The next call of the caller whose turn it is; None once the pool is closed."""
        with self._changed:
            while not self._closed:
                share = self._share()
                for name, caller in self._callers.items():
                    if caller.waiting and caller.running < share:
                        caller.running += 1
                        self._callers.move_to_end(name)  # the others come first next time
                        return (name, *caller.waiting.popleft())
                self._changed.wait()
            return None

    def _share(self) -> int:
        """How many threads one caller may hold now."""
        recent = self._clock() - _RECENT_S
        self._called = {name: at for name, at in self._called.items() if at > recent or name in self._callers}
        count = len(self._called)
        return max(1, self._size - 1 if count < 2 else self._size // (2 * count))

    def _done(self, name: str) -> None:
        with self._changed:
            self._callers[name].running -= 1
            self._forget(name)
            self._changed.notify_all()

    def _drop(self, name: str, future: Future[Any]) -> None:
        """Take a cancelled call out of its queue, so that what nobody waits for holds no memory."""
        with self._changed:
            if (caller := self._callers.get(name)) is not None:
                caller.waiting = deque(entry for entry in caller.waiting if entry[0] is not future)
                self._forget(name)

    def _forget(self, name: str) -> None:
        caller = self._callers[name]
        if not caller.waiting and not caller.running:
            del self._callers[name]
