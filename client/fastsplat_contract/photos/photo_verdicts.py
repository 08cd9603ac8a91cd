"""What became of each photo of a capture: whether it has a place in the scene, and what is wrong with it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal, NamedTuple

from pydantic import Field

from fastsplat_contract.codec.wire import Many, Response, travels
from fastsplat_contract.messages.scenes import NextPageToken

NotPlaced = Literal[
    "few_features", "no_overlap", "few_matches", "other_model", "masked", "unknown", "lens", "unreadable"
]
PhotoDefect = Literal["blurred", "dark", "duplicate"]


@dataclass(frozen=True)
class PhotoVerdict(Response):
    """One photo of a capture."""

    name: Annotated[str, Field(description="as in the upload, and as the camera of the scene that it is")]
    placed: Annotated[bool, Field(description="whether it is one of the scene's cameras")]
    not_placed: Annotated[
        NotPlaced | None,
        Field(
            description="why it is none. few_features: hardly any texture; no_overlap: it shows nothing that another "
            "photo shows; few_matches: too little of that; other_model: it belongs to a group of photos that shares "
            "nothing with the scene's; masked: its mask leaves no pixel; unknown: structure from motion did not say; "
            "lens: what it was taken with could not be worked out; unreadable: its file is damaged"
        ),
    ]
    defects: Annotated[
        Many[PhotoDefect],
        Field(
            description="of the photo itself, placed or not. blurred: much less sharp than the others; dark: nearly "
            "black; duplicate: it shows the same from the same place as another one"
        ),
    ]
    duplicate_of: Annotated[str, Field(description="for duplicate: the name of that photo, else empty")]
    sharpness: Annotated[float, Field(description="1: as sharp as the middle one of the capture's photos")]
    brightness: Annotated[float, Field(description="nine of ten pixels are darker than this, 0..1")]
    matches: Annotated[
        int | None,
        Field(description="points that it shares with the photo that shares most; absent: poses came with the upload"),
    ]
    advice: Annotated[str, Field(description="what to do about it, in plain words; empty where all is well")]
    withheld: Annotated[
        float, Field(description="share of its pixels, 0..1, that were left out because they show what moves")
    ] = 0.0
    between: Annotated[
        Many[str],
        Field(
            description="of a photo without a place: the placed photo that shares most with it, and itself; a photo "
            "taken between the two would join it. Empty where none shares anything with it"
        ),
    ] = ()
    exposure_ev: Annotated[
        float | None,
        Field(
            description="by how many EV more light it took than the mean of the photos, as training estimated it; "
            "absent before that, where photos were not found to differ, and of photos that were not trained on"
        ),
    ] = None
    red_ev: Annotated[
        float | None, Field(description="its white balance: gain of red against green, EV; absent as exposure_ev")
    ] = None
    blue_ev: Annotated[
        float | None, Field(description="its white balance: gain of blue against green, EV; absent as exposure_ev")
    ] = None


@travels(request=False, proto="ListPhotoVerdictsResponse")
class PhotoVerdictList(NamedTuple):
    """One page of a capture's photos, in the order of their names."""

    photos: Many[PhotoVerdict]
    next_page_token: NextPageToken
    assessed: Annotated[
        bool,
        Field(
            description="whether the photos were looked at: not before the capture stage is done, and not where there "
            "are no photos"
        ),
    ]
    placed_count: Annotated[int, Field(description="of all the photos, those that have a place")]
    photo_count: Annotated[int, Field(description="of all the photos, not of this page alone")]
