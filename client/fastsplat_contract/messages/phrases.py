"""What was understood of a question that says more than a name, and what it was decided by."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal, NamedTuple

from pydantic import Field

from fastsplat_contract.codec.wire import Many, Response, travels

Asks = Literal["objects", "count"]
RefusalReason = Literal[
    "not_understood", "ambiguous", "pose_needed", "vertical_unknown", "too_close", "out_of_view", "indirect",
    "ambiguous_referent", "referent_absent", "nothing_to_compare", "not_measured", "not_named", "not_read",
]  # fmt: skip


@travels(request=False)
class Refusal(NamedTuple):
    """Why it cannot be decided which objects a question means."""

    reason: Annotated[
        RefusalReason,
        Field(
            description="not_understood: words were left over; ambiguous: it can be read in several ways, with "
            "different answers; pose_needed: send where the asker stands; vertical_unknown: the scene does not tell "
            "what is up; too_close: a measurement is too near to its bound; out_of_view: behind the asker, or too "
            "near; indirect: it rests on something else that rests on that; ambiguous_referent: it speaks of one "
            "object, and several here are called that; referent_absent: nothing here is what it speaks of; "
            "nothing_to_compare: there is only one; not_measured: nothing here measures that; not_named: nothing here "
            "bears the name that it asks for; not_read: no photo shows that written on what it asks for"
        ),
    ]
    part: Annotated[str, Field(description="the words of the question that it is about")]


@travels(request=False)
class Witness(NamedTuple):
    """One measurement that decided, or failed to decide, whether an object is meant."""

    condition: Annotated[str, Field(description="what was asked of the object, in words")]
    object_id: Annotated[int, Field(description="its id")]
    compared_ids: Annotated[Many[int], Field(description="ids of the objects that it was compared with")]
    measure: Annotated[
        str,
        Field(
            description="what was measured: gap, overlap, enclosure, depth, level, direction, offset, angle, "
            "distance, size, height, length, width, elevation, color_distance, part, read"
        ),
    ]
    value: float
    unit: Annotated[
        str,
        Field(
            description="m; unit: of the scene; deg; share: 0..1; delta_e: CIE94 in CIELAB; ratio; empty: none of these"
        ),
    ]
    clearness: Annotated[
        float,
        Field(
            description="how clear it is: 0 in the middle of what cannot be decided, above 0 where the condition "
            "holds, below where it does not; decided from 1 and from -1 on"
        ),
    ]


@dataclass(frozen=True)
class PhraseAnswer(Response):
    """What was understood of a question that says more than a name, and which objects that means."""

    asks: Annotated[Asks, Field(description="objects: which; count: how many")]
    head: Annotated[str, Field(description="what is asked for; empty: anything")]
    conditions: Annotated[Many[str], Field(description="what is asked of it, in words")]
    not_understood: Annotated[str, Field(description="words that were left over; empty: none")]
    object_ids: Annotated[
        Many[int], Field(description="ids of the objects that fulfil all that was understood; in their order")
    ]
    undecided: Annotated[Many[int], Field(description="ids of objects of which it could not be decided")]
    witnesses: Annotated[Many[Witness], Field(description="by which measurements; the first 200")]
    count: Annotated[int | None, Field(description="how many, fragments once, if that was asked and decided")] = None
    refusal: Annotated[
        Refusal | None,
        Field(
            description="why it could not be decided; the verdict is then undecided, and the answer's objects are "
            "those of which it could not be"
        ),
    ] = None
