"""Prometheus metrics of calls and jobs, served on a separate port."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass
from functools import cache
from typing import Any

from prometheus_client import CollectorRegistry, Counter, Gauge, Histogram, start_http_server
from prometheus_client.core import GaugeMetricFamily, Metric
from prometheus_client.registry import Collector

from fastsplat.service.application.admin.service_metrics import ServiceMetrics
from fastsplat_contract.errors import FastSplatError, ResourceError

current_route: ContextVar[str] = ContextVar("current_route", default="other")
"""Matched route (REST) or method (gRPC) of the running task."""

_log = logging.getLogger(__name__)
_SECONDS = (0.001, 0.0025, 0.005, 0.01, 0.025, 0.05, 0.1, 0.25, 0.5, 1.0, 2.5, 5.0, 10.0, 30.0)
_STAGE_SECONDS = (1.0, 3.0, 10.0, 30.0, 60.0, 120.0, 300.0, 600.0, 1800.0, 3600.0, 14400.0)


@dataclass(frozen=True)
class _Meters:
    """Metrics of one route, cached because looking up labels costs more than counting."""

    waited: Histogram
    computed: Histogram
    answered: Histogram
    in_flight: Gauge
    outcome: Callable[[str], Counter]

    def count(self, status: str) -> None:
        self.outcome(status).inc()


class Metrics:
    """Thread-safe metrics of one server process."""

    def __init__(self) -> None:
        self.registry = CollectorRegistry()
        here = self.registry
        self._waited = Histogram(
            "fastsplat_queue_seconds",
            "From a call's arrival at a pool to its thread",
            ["route"],
            buckets=_SECONDS,
            registry=here,
        )
        self._computed = Histogram(
            "fastsplat_compute_seconds", "On the thread", ["route"], buckets=_SECONDS, registry=here
        )
        self._answered = Histogram(
            "fastsplat_request_seconds", "From head to last byte", ["route"], buckets=_SECONDS, registry=here
        )
        self._outcomes = Counter("fastsplat_requests", "Answers by status", ["route", "status"], registry=here)
        self._in_flight = Gauge("fastsplat_in_flight", "Requests under way", ["route"], registry=here)
        self._routes: dict[str, _Meters] = {}
        self._waiting = Gauge("fastsplat_queued_calls", "Calls that wait for a thread", registry=here)
        self._computing = Gauge("fastsplat_running_calls", "Calls on a thread", registry=here)
        self._refused = Counter("fastsplat_rejected", "Refused before any work", ["reason"], registry=here)
        self._stages = Histogram(
            "fastsplat_job_stage_seconds",
            "Stages of the jobs that ended",
            ["stage"],
            buckets=_STAGE_SECONDS,
            registry=here,
        )

    @contextmanager
    def request(self, route: str) -> Iterator[Callable[[str], None]]:
        """Measures one request; call the yielded function with its status, e.g. "200" or "OK"."""
        meters = self._of(route)
        started = time.perf_counter()
        meters.in_flight.inc()
        current_route.set(route)  # each request has its own task
        try:
            yield meters.count
        finally:
            meters.in_flight.dec()
            meters.answered.observe(time.perf_counter() - started)

    def _of(self, route: str) -> _Meters:
        meters = self._routes.get(route)
        if meters is None:
            meters = self._routes[route] = _Meters(
                self._waited.labels(route),
                self._computed.labels(route),
                self._answered.labels(route),
                self._in_flight.labels(route),
                cache(lambda status: self._outcomes.labels(route, status)),
            )
        return meters

    def refused(self, reason: str) -> None:
        """Counts a refused request by reason: UNAUTHENTICATED, RATE_LIMITED, OVERLOADED, ..."""
        self._refused.labels(reason).inc()

    @contextmanager
    def queued(self) -> Iterator[Call]:
        """Measures one call from before it is submitted until it ends or is abandoned."""
        call = Call(current_route.get(), self)
        self._waiting.inc()
        try:
            yield call
        finally:
            if call.never_ran():
                self._waiting.dec()

    def _begun(self, call: Call) -> None:
        self._waiting.dec()
        self._computing.inc()
        self._of(call.route).waited.observe(time.perf_counter() - call.at)

    def _ended(self, call: Call) -> None:
        self._computing.dec()
        self._of(call.route).computed.observe(time.perf_counter() - call.at)

    def watch_jobs(self, metrics: ServiceMetrics) -> None:
        """Adds metrics of jobs and scenes, read from the database at each scrape."""
        self.registry.register(_Jobs(metrics, self._stages))


class Call:
    """Timing of one call from submission to end."""

    def __init__(self, route: str, metrics: Metrics) -> None:
        self.route = route
        self.at = time.perf_counter()
        self.future: Future[Any] | None = None
        self._metrics = metrics

    @contextmanager
    def running(self) -> Iterator[None]:
        """Times the call; entered on its thread."""
        self._metrics._begun(self)
        self.at = time.perf_counter()
        try:
            yield
        finally:
            self._metrics._ended(self)

    def never_ran(self) -> bool:
        """Returns True if the call was abandoned before a thread took it."""
        return self.future is None or self.future.cancelled()


class _Jobs(Collector):
    def __init__(self, metrics: ServiceMetrics, stages: Histogram) -> None:
        self._metrics = metrics
        self._stages = stages

    def collect(self) -> Iterable[Metric]:
        try:
            jobs, ended = self._metrics.jobs(), self._metrics.newly_ended_stages()
        except FastSplatError as error:
            _log.warning("no metrics of the jobs: %s", error.message)
            return
        for stage, seconds in ended:
            self._stages.labels(stage).observe(seconds)
        by_state = GaugeMetricFamily("fastsplat_jobs", "Jobs by state", labels=["state"])
        for state, count in jobs.items():
            by_state.add_metric([state], count)
        yield by_state
        yield GaugeMetricFamily(
            "fastsplat_open_scenes", "Scenes kept open for queries", value=self._metrics.open_scenes()
        )

    def describe(self) -> Iterable[Metric]:
        return ()


def serve_metrics(metrics: Metrics, host: str, port: int) -> tuple[int, Callable[[], None]]:
    """Serves /metrics on a thread; returns the port and a stop function.

    Raises:
        ResourceError: the port is not available.
    """
    try:
        server, thread = start_http_server(port, host, metrics.registry)
    except OSError as error:
        raise ResourceError(
            f"metrics cannot listen on {host}:{port}: {error.strerror}",
            field="metrics_port",
            hint="Set FASTSPLAT_METRICS_PORT to a free port.",
        ) from error

    def stop() -> None:
        server.shutdown()
        server.server_close()
        thread.join()

    return server.server_port, stop
