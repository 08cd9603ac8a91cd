"""Fair thread pool: one queue per caller, served round robin (RFC 970).

Long calls run on threads of lower priority, so that the operating system prefers short calls.
"""

from __future__ import annotations

import math
import threading
import time
from collections import OrderedDict, deque
from collections.abc import Callable
from concurrent.futures import Future
from dataclasses import dataclass, field
from typing import Any, TypeVar

from fastsplat.service.common.process import lower_priority

_R = TypeVar("_R")

_RECENT_S = 10.0
"""Window in which a caller counts as active; time constant of its fading use."""
_SPARED_S = 0.5
"""Recent use up to this is never over a caller's share."""
_OVER = 1.5
"""Multiple of the mean use above which a caller is over its share."""


@dataclass
class _Caller:
    """A caller's waiting and running calls by class: 0 normal priority, 1 background."""

    waiting: tuple[deque[_Entry], deque[_Entry]] = field(default_factory=lambda: (deque(), deque()))
    running: list[int] = field(default_factory=lambda: [0, 0])

    @property
    def idle(self) -> bool:
        return not any(self.waiting) and not any(self.running)


@dataclass(frozen=True)
class _Entry:
    future: Future[Any]
    function: Callable[[], Any]


@dataclass
class _Use:
    """Seconds on threads up to `at`, decaying with `_RECENT_S`; running calls count continuously."""

    seconds: float
    at: float
    called_at: float
    running: int = 0

    def advance(self, now: float) -> float:
        fading = math.exp((self.at - now) / _RECENT_S)
        self.seconds = self.seconds * fading + self.running * _RECENT_S * (1 - fading)
        self.at = now
        return self.seconds


class FairPool:
    """Thread pool for blocking work, round robin over callers.

    Long calls, and those of callers that recently used more than their share while others were active, run on a second
    class of threads of low priority. A single active caller gets all threads of a class but one, so that another's call
    starts at once; several get smaller shares, because there are more threads than cores.

    Args:
        size: threads of each class, at least one.
        name: prefix of the threads' names.
        niceness: added to the process's niceness for background threads and their children; Linux only.
        clock: seconds.
    """

    def __init__(self, size: int, name: str, niceness: int = 0, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._uses: dict[str, _Use] = {}
        self._callers: OrderedDict[str, _Caller] = OrderedDict()
        self._changed = threading.Condition()
        self._closed = False
        self._size = size
        self._name = name
        self._niceness = niceness
        self._threads: tuple[list[threading.Thread], list[threading.Thread]] = ([], [])

    def submit(self, caller: str, function: Callable[[], _R], *, background: bool = False) -> Future[_R]:
        """Queues a call, at low priority if `background`; a waiting call can be cancelled.

        Raises:
            RuntimeError: the pool is closed.
        """
        future: Future[_R] = Future()
        with self._changed:
            if self._closed:
                raise RuntimeError("the pool is closed")
            now = self._clock()
            self._uses.setdefault(caller, _Use(0.0, now, now)).called_at = now
            background = background or self._is_over_share(caller, now)
            self._callers.setdefault(caller, _Caller()).waiting[background].append(_Entry(future, function))
            self._changed.notify_all()
            threads = self._threads[background]
            if len(threads) < self._size:  # threads start on demand
                prefix = f"{self._name}_background" if background else self._name
                thread = threading.Thread(
                    target=self._work, args=(background,), name=f"{prefix}_{len(threads)}", daemon=True
                )
                threads.append(thread)
                thread.start()
        future.add_done_callback(lambda done: self._drop(caller, done) if done.cancelled() else None)
        return future

    def close(self) -> None:
        """Waits for running calls and cancels waiting ones."""
        with self._changed:
            self._closed = True
            waiting = [entry.future for caller in self._callers.values() for queue in caller.waiting for entry in queue]
            self._changed.notify_all()
        for future in waiting:
            future.cancel()
        for thread in (*self._threads[0], *self._threads[1]):
            thread.join()

    def _work(self, background: bool) -> None:
        if background and self._niceness:
            lower_priority(self._niceness)
        while (taken := self._take(background)) is not None:
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
                self._done(name, background)

    def _take(self, background: bool) -> tuple[str, Future[Any], Callable[[], Any]] | None:
        """Waits for the next call in turn; None once the pool is closed."""
        with self._changed:
            while not self._closed:
                now = self._clock()
                share = self._share(now)
                for name, caller in self._callers.items():
                    if caller.waiting[background] and caller.running[background] < share:
                        caller.running[background] += 1
                        use = self._uses[name]
                        use.advance(now)
                        use.running += 1
                        self._callers.move_to_end(name)  # round robin
                        entry = caller.waiting[background].popleft()
                        return name, entry.future, entry.function
                self._changed.wait()
            return None

    def _share(self, now: float) -> int:
        """Computes the number of threads of a class that one caller may hold now."""
        self._forget_uses(now)
        count = len(self._uses)
        return max(1, self._size - 1 if count < 2 else self._size // (2 * count))

    def _is_over_share(self, caller: str, now: float) -> bool:
        self._forget_uses(now)
        uses = {name: use.advance(now) for name, use in self._uses.items()}
        return len(uses) > 1 and uses[caller] > max(_SPARED_S, _OVER * sum(uses.values()) / len(uses))

    def _forget_uses(self, now: float) -> None:
        recent = now - _RECENT_S
        self._uses = {name: use for name, use in self._uses.items() if use.called_at > recent or name in self._callers}

    def _done(self, name: str, background: bool) -> None:
        with self._changed:
            self._callers[name].running[background] -= 1
            use = self._uses[name]
            use.advance(self._clock())
            use.running -= 1
            self._forget(name)
            self._changed.notify_all()

    def _drop(self, name: str, future: Future[Any]) -> None:
        """Removes a cancelled call from its queue, which frees its memory."""
        with self._changed:
            if (caller := self._callers.get(name)) is not None:
                for queue in caller.waiting:
                    for entry in queue:
                        if entry.future is future:
                            queue.remove(entry)
                            break
                self._forget(name)

    def _forget(self, name: str) -> None:
        if self._callers[name].idle:
            del self._callers[name]
