"""HTTP transport with one deadline per call and retries of idempotent calls."""

from __future__ import annotations

import random
import ssl
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import httpx

from fastsplat_client.errors import UnreachableError, problem_of
from fastsplat_contract.errors import DeadlineExceededError

_AGAIN = (429, 502, 503, 504)


@dataclass(frozen=True)
class Retry:
    """Retry policy of idempotent calls: exponential backoff, shortened at random by up to half.

    The server's Retry-After takes precedence.

    Examples:
        >>> 0.5 <= Retry(first_s=1.0).pause(0) <= 1.0, 2.5 <= Retry(most_s=5.0).pause(9) <= 5.0
        (True, True)
    """

    tries: int = 4  # in all
    first_s: float = 0.2  # first pause
    most_s: float = 5.0  # longest pause

    def pause(self, attempt: int) -> float:
        """Computes the pause in seconds after the failed call `attempt`, from 0."""
        return min(self.most_s, self.first_s * 2.0 ** min(attempt, 60)) * random.uniform(0.5, 1.0)


class Transport:
    """Thread-safe HTTP connections to one server; parameters as of `Client` (`carrier`: its `transport`)."""

    def __init__(
        self,
        url: str,
        headers: Mapping[str, str],
        ca: Path | None,
        timeout_s: float,
        retry: Retry,
        carrier: httpx.BaseTransport | None = None,
    ) -> None:
        verify = ssl.create_default_context(cafile=str(ca)) if ca is not None else True
        self._http = httpx.Client(
            base_url=url, headers=headers, verify=verify, follow_redirects=False, transport=carrier
        )
        self._timeout_s = timeout_s
        self._retry = retry

    def close(self) -> None:
        self._http.close()

    def call(
        self,
        method: str,
        path: str,
        *,
        params: Mapping[str, Any] | None = None,
        json: Any = None,
        content: Callable[[], dict[str, Any]] = dict,
        headers: Mapping[str, str] | None = None,
        repeatable: bool = True,
        timeout_s: float | None = None,
    ) -> httpx.Response:
        """Makes a request and returns the complete successful response.

        Args:
            content: builds further httpx arguments for each try, for streamed bodies.
            repeatable: False: do not retry if the server may have acted.
            timeout_s: for all tries together.

        Raises:
            FastSplatError: the server's error, `UnreachableError` or `DeadlineExceededError`.
        """

        def send(timeout: httpx.Timeout) -> httpx.Response:
            return self._http.request(
                method, path, params=params, json=json, headers=headers, timeout=timeout, **content()
            )

        return self._tried(send, repeatable, timeout_s)

    @contextmanager
    def streamed(
        self, path: str, *, params: Mapping[str, Any] | None = None, headers: Mapping[str, str] | None = None
    ) -> Iterator[httpx.Response]:
        """Opens a GET whose body the caller reads; the default timeout applies to each piece.

        Raises:
            FastSplatError: as `call`; also while the body is read.
        """

        def send(timeout: httpx.Timeout) -> httpx.Response:
            request = self._http.build_request("GET", path, params=params, headers=headers, timeout=timeout)
            response = self._http.send(request, stream=True)
            if not response.is_success:
                response.read()
            return response

        response = self._tried(send, True, None)
        try:
            yield response
        except httpx.TransportError as error:
            raise UnreachableError(f"the answer broke off: {error}", hint="Continue, or try again.") from error
        finally:
            response.close()

    def _tried(
        self, send: Callable[[httpx.Timeout], httpx.Response], repeatable: bool, timeout_s: float | None
    ) -> httpx.Response:
        deadline = time.monotonic() + (self._timeout_s if timeout_s is None else timeout_s)
        for attempt in range(self._retry.tries):
            last = attempt == self._retry.tries - 1
            pause = self._retry.pause(attempt)
            try:
                response = send(httpx.Timeout(max(0.001, deadline - time.monotonic())))
                if response.is_success or response.status_code == 304:
                    return response
                error = problem_of(response.content, response.status_code, response.headers.get("retry-after", ""))
                # 429 is sent before any work, so that even non-idempotent calls may be retried.
                again = response.status_code in _AGAIN and (repeatable or response.status_code == 429)
                pause = pause if error.retry_after_s is None else error.retry_after_s
            except httpx.TimeoutException as broken:
                raise DeadlineExceededError("no answer in time", hint="Give it more time.") from broken
            except httpx.TransportError as broken:
                again = repeatable or isinstance(broken, httpx.ConnectError)
                error = UnreachableError(f"{type(broken).__name__}: {broken}", hint="Is the server running?")
                error.__cause__ = broken
            if last or not again or time.monotonic() + pause > deadline:
                raise error
            time.sleep(pause)
        raise AssertionError


class Event(NamedTuple):
    """One event; its `id` resumes the stream after it."""

    id: str
    data: str
    kind: str = "message"


def events_of(lines: Iterable[str]) -> Iterator[Event]:
    """Yields the complete events of a stream's lines."""
    name, kind, data = "", "", list[str]()
    for line in lines:
        if not line:
            if data:
                yield Event(name, "\n".join(data), kind or "message")
            kind, data = "", []
        elif not line.startswith(":"):
            field, _, value = line.partition(":")
            value = value.removeprefix(" ")
            if field == "data":
                data.append(value)
            elif field == "id":
                name = value
            elif field == "event":
                kind = value
