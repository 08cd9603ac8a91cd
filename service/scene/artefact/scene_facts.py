"""Facts of a scene beside its measured quality; both are one JSON object where they are stored and shown."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from datetime import UTC, datetime
from functools import cache
from typing import Any, Literal, get_type_hints

from pydantic import TypeAdapter, ValidationError

from fastsplat.service.common.withheld import WithheldReport
from fastsplat_contract.jobs.job_watching import Provisional

LabelSource = Literal["none", "given", "detected"]
"""Origin of a scene's labels: none, the capture's label maps, or detection."""


@dataclass(frozen=True)
class SceneFacts:
    """Origin and state of a scene version; None: not recorded."""

    source: str | None = None  # kind of upload
    splat: str | None = None  # name of the upload's splat file; "" for none
    preset: str | None = None
    time_asked_s: float | None = None  # for everything after the capture stage
    tradeoffs: tuple[str, ...] | None = None  # reductions due to the time budget, in words
    stopped_early: bool | None = None  # training was ended by request
    warnings: tuple[str, ...] | None = None
    unregistered: tuple[str, ...] | None = None  # names of images without a pose
    left_out: Mapping[str, str] | None = None  # reason by file of the upload
    withheld: WithheldReport | None = None
    taken_at: Mapping[str, float] | None = None  # times of photos by camera, seconds since 1970
    held_out_views: tuple[str, ...] | None = None
    label_source: LabelSource | None = None
    searched_names: int | None = None  # number of `searched_for`
    searched_for: tuple[str, ...] | None = None  # names that were looked for in the photos
    found_shares: Mapping[str, float] = field(default_factory=dict)  # see `Vocabulary`; by name searched
    scale_source: str | None = None  # of meters measured by the capture: sources joined by "+"
    scale_error_95: float | None = None  # half the 95 % interval of a length, relative
    vertical_source: str | None = None  # of the capture's vertical, which is +z of the trained version
    vertical_deviation_deg: float | None = None  # 1 sigma
    changed_by: tuple[str, ...] = ()  # actions that made the version deviate from its photos
    draft: Provisional | None = None  # None for a finished scene

    @property
    def newest_photo_at(self) -> datetime | None:
        """Capture time of the newest photo; None if unknown."""
        return datetime.fromtimestamp(max(self.taken_at.values()), UTC) if self.taken_at else None

    def with_quality(self, quality: Mapping[str, Any]) -> dict[str, Any]:
        """Returns facts and measured quality as they are stored and shown; inverts `split_quality`."""
        facts = _adapter(SceneFacts).dump_python(self, mode="json", exclude_defaults=True)
        if self.draft is not None:
            facts["draft"] = self.draft._asdict()
        return {**({} if self.source is None else {"preset": None}), **facts, **quality}


def split_quality(stored: Mapping[str, Any]) -> tuple[SceneFacts, dict[str, Any]]:
    """Splits a stored quality into facts and the rest, which keeps values that are not of their field's type."""
    facts, rest = {}, dict(stored)
    for name in _readers().keys() & stored.keys():
        with suppress(ValidationError):
            facts[name] = _readers()[name](stored[name])
            del rest[name]
    return SceneFacts(**facts), rest


_adapter = cache(TypeAdapter)


@cache
def _readers() -> Mapping[str, Callable[[Any], Any]]:
    return {name: TypeAdapter(kind).validate_python for name, kind in get_type_hints(SceneFacts).items()}
