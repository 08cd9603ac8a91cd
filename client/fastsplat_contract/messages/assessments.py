"""How good a scene is, against what its capture allows, and what its maker may do about it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal

from pydantic import Field

from fastsplat_contract.codec.wire import Many, Response

Grade = Literal["good", "fair", "poor"]


@dataclass(frozen=True)
class Finding(Response):
    """One object that keeps a scene from being better."""

    reason: Annotated[str, Field(description="stable across releases, as FEW_PHOTOS")]
    grade: Annotated[Grade, Field(description="how much it costs: fair or poor")]
    message: Annotated[str, Field(description="what was measured, one sentence")]
    advice: Annotated[str, Field(description="what to do about it, one sentence")]


@dataclass(frozen=True)
class Assessment(Response):
    """How good a scene is."""

    grade: Annotated[Grade, Field(description="good: to be relied on; fair: look before relying; poor: make it anew")]
    findings: Annotated[Many[Finding], Field(description="what is short of good, the worst first; none if it is good")]
