"""How long a job still takes: what its stage says of itself, and what the cost model says of the stages after it;
nothing where that cannot be predicted, as for the capture of a video."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, replace

from fastsplat.service.common.progress import Progress, ProgressEvent

_LEAST_FRACTION, _LEAST_SECONDS = 0.05, 1.0
"""Before that, the rate of a stage says nothing."""


@dataclass(frozen=True)
class Forecast:
    """What is known of a job when one of its stages begins.

    Attributes:
        later_s: seconds of all stages after this one; None: unknown.
        own_s: seconds of this stage; None: its rate will tell.
        tail_s: seconds of this stage after the work whose end it predicts itself by the metric seconds_left.
        bound_s: seconds in which this stage and all after it are planned to end; None: no bound.
    """

    later_s: float | None
    own_s: float | None = None
    tail_s: float = 0.0
    bound_s: float | None = None


class _TimeLeft:
    """Counts down from what was last said of a stage: by itself, by the model, or by the rate at which it last came
    forward. What has counted down to nothing is not known any more."""

    def __init__(self, forecast: Forecast) -> None:
        self._forecast = forecast
        self._ends_s, self._by_rate = forecast.own_s, forecast.own_s is None
        self._fraction = 0.0

    def seconds(self, event: ProgressEvent, elapsed_s: float) -> float | None:
        """Seconds until the whole job is done, `elapsed_s` seconds after the stage began; None: unknown."""
        forecast = self._forecast
        own = self._own(event, elapsed_s)
        known = None if own is None or forecast.later_s is None else own + forecast.later_s
        if forecast.bound_s is None or elapsed_s >= forecast.bound_s:
            return known
        left = forecast.bound_s - elapsed_s
        return left if known is None else min(known, left)

    def _own(self, event: ProgressEvent, elapsed_s: float) -> float | None:
        if "seconds_left" in event.metrics:
            self._ends_s, self._by_rate = elapsed_s + event.metrics["seconds_left"] + self._forecast.tail_s, False
        elif self._by_rate:
            if event.fraction >= 1:
                return 0.0
            came_forward, self._fraction = event.fraction > self._fraction, max(event.fraction, self._fraction)
            if came_forward and event.fraction >= _LEAST_FRACTION and elapsed_s >= _LEAST_SECONDS:
                self._ends_s = elapsed_s / event.fraction
        return self._ends_s - elapsed_s if self._ends_s is not None and elapsed_s < self._ends_s else None


def with_time_left(progress: Progress, forecast: Forecast, clock: Callable[[], float] = time.monotonic) -> Progress:
    """A `Progress` of a stage that begins now, whose events say how long the whole job still takes, where that is
    known, as the metric job_seconds_left; -1 where it is not known any more."""
    started, time_left = clock(), _TimeLeft(forecast)

    def tell(event: ProgressEvent) -> None:
        left = time_left.seconds(event, clock() - started)
        progress(
            replace(event, metrics={**event.metrics, "job_seconds_left": -1.0 if left is None else round(left, 1)})
        )

    return tell
