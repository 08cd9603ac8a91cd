"""Which Gaussians of a scene are meant: by a box, by opacity, by how far they are from others."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from pydantic import Field

from fastsplat_contract.codec.wire import Request
from fastsplat_contract.geometry.poses import Box


@dataclass(frozen=True)
class GaussianFilter(Request):
    """Gaussians that fulfil all that is said here: at least one of box, opacity_below and isolation_above."""

    box: Annotated[Box | None, Field(description="whose centers lie in it")] = None
    outside: Annotated[bool, Field(description="with a box: whose centers lie outside of it instead")] = False
    opacity_below: Annotated[float | None, Field(description="that are less opaque than this, above 0, up to 1")] = None
    isolation_above: Annotated[
        float | None,
        Field(
            description="floaters: whose eighth nearest neighbor is more than so many times farther away than the "
            "scene's median has it, center to center; above 0, and from 4 on few belong to a surface"
        ),
    ] = None
