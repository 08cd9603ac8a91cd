"""Photos of a scene's cameras, and which cameras show an object best."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, NamedTuple

from pydantic import Field

from fastsplat_contract.codec.wire import Int64, Many, Response, travels
from fastsplat_contract.masks import ViewMask
from fastsplat_contract.messages.scenes import NextPageToken


@travels(request=False)
class ScenePhoto(NamedTuple):
    """A photo that is stored with a scene."""

    view: Annotated[str, Field(description="name of the scene's camera that took it")]
    size_bytes: Annotated[Int64, Field(description="of the JPEG file")]


@travels(request=False, proto="ListPhotosResponse")
class PhotoList(NamedTuple):
    """One page of a scene's photos, in the order of its cameras."""

    photos: Many[ScenePhoto]
    next_page_token: NextPageToken
    version: Annotated[str, Field(description="which version was read")]


@dataclass(frozen=True)
class BestView(Response):
    """One of the scene's cameras that show some objects, and where in its picture they are."""

    view: Annotated[str, Field(description="the camera's name")]
    share: Annotated[float, Field(description="of the picture's pixels that show the objects, 0..1")]
    cut_off: Annotated[bool, Field(description="whether the objects reach the picture's edge")]
    photo: Annotated[bool, Field(description="whether the photo is stored with the scene")]
    mask: Annotated[ViewMask, Field(description="where the objects are, in a picture reduced to 256 pixels a side")]


@travels(request=False, proto="ListBestViewsResponse")
class BestViewList(NamedTuple):
    """The cameras that show some objects best, best first."""

    views: Many[BestView]
    version: Annotated[str, Field(description="which version was read")]
