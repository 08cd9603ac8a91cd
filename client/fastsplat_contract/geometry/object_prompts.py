"""Places in a picture, and prompts of a segmenter made of them: what an object is, shown by clicks or a box."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, NamedTuple

from pydantic import Field

from fastsplat_contract.codec.wire import Int64, Many, OneOf, Request, Response, travels
from fastsplat_contract.geometry.camera import PosedCamera, ViewName

PROMPTED = ("split", "add")
"""The edits that say by a prompt which Gaussians they mean."""


@travels(request=True)
class Pixel(NamedTuple):
    """A place in a picture; the middle of its first pixel is (0.5, 0.5)."""

    x: Annotated[float, Field(description="pixels from the left edge, below the width")]
    y: Annotated[float, Field(description="pixels from the top edge, below the height")]


@travels(request=True)
class PixelBox(NamedTuple):
    """A rectangle in a picture; the middle of the first pixel is (0.5, 0.5)."""

    left: Annotated[float, Field(description="pixels from the left edge")]
    top: Annotated[float, Field(description="pixels from the top edge")]
    right: Annotated[float, Field(description="pixels from the left edge, above `left`, at most the width")]
    bottom: Annotated[float, Field(description="pixels from the top edge, above `top`, at most the height")]


@dataclass(frozen=True)
class ObjectPrompt(Request):
    """Where one object is in the picture of a view: pixels on it, a box around it, or both."""

    camera: Annotated[PosedCamera | None, OneOf("viewpoint"), Field(description="a free viewpoint")] = None
    view: ViewName = None
    pixels: Annotated[Many[Pixel], Field(description="on the object; with a box they may be left out")] = ()
    background: Annotated[Many[Pixel], Field(description="beside the object")] = ()
    box: Annotated[PixelBox | None, Field(description="around the object")] = None


@dataclass(frozen=True)
class PromptedObject(Response):
    """What an edit made of a prompt."""

    edit: Annotated[int, Field(description="number of the edit in its request, from 0")]
    object_id: Annotated[int, Field(description="of the new object")]
    gaussian_count: Annotated[Int64, Field(description="that the new object got")]
    views: Annotated[
        Many[str],
        Field(
            description="the views whose renderings were segmented and agree, the prompt's own first; a free viewpoint "
            "has no name"
        ),
    ]
