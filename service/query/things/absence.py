"""What it means that a scene has nothing for a text: what was looked for, and what may be the thing all the same."""

from __future__ import annotations

from dataclasses import dataclass

from fastsplat.service.scene.artefact.scene import Scene
from fastsplat_contract.geometry.poses import Vector3
from fastsplat_contract.messages.queries import Searched

RATHER = 0.5
"""What is said to be here, or not here, is at least so likely; what is less likely is possible, or cannot be said."""

HIDES = 0.07
"""Share of a place that no photo shows, from which on a thing that was not found may be there."""


USUAL_M = 0.22
"""How wide a place must be for a thing of a usual size, meters: chosen on drawn rooms, see docs/asking.md."""


@dataclass(frozen=True)
class Hollow:
    """The largest space inside of a thing that no photo shows."""

    thing: int  # its id, or that of the label where no things are stored
    volume: float  # scene units cubed
    width: float  # of the largest ball that fits into it, scene units
    middle: Vector3  # of that ball, world frame
    view: str = ""  # the camera nearest to it that has it in the picture; "" for none


@dataclass(frozen=True)
class UnseenSpace:
    """What of a place no photo shows, see `unseen_space`.

    Attributes:
        behind: what hides most of it, the most first: ids of things, or of labels where no things are stored.
        middle: of the largest ball that fits into the space between things, world frame; None where `share` is 0.
        meter: scene units that count as a meter: 1 in a scene that has meters; elsewhere half of the things are taken
            to be `USUAL_M` long at most.
    """

    share: float  # 0..1, of the space between the things
    behind: tuple[int, ...]
    middle: Vector3 | None = None
    hollows: tuple[Hollow, ...] = ()  # of things, whether they are hollow or solid, the largest first
    meter: float = 1.0
    in_meters: bool = False  # whether the scene has meters

    @property
    def hides(self) -> bool:
        """Whether so much is unseen that a thing which was not found may be there."""
        return self.share >= HIDES


ALL_SEEN = UnseenSpace(0.0, ())


def searched_names(scene: Scene) -> int | None:
    """How many names a detector looked for in the scene's photos, or its label maps had; None if nobody noted it."""
    count = scene.quality.get("searched_names")
    return count if isinstance(count, int) and not isinstance(count, bool) else None


def unnamed_probability(searched: Searched) -> float:
    """0..1: that a thing without a name is what was asked for, when no named thing is.

    Before anything is looked at, it is as likely as not that the scene has what is asked for, and if so, that it is any
    of its things. That none of the n named things is it leaves (u / (n + u)) / (u / (n + u) + 1) = u / (n + 2u) for the
    u things without a name.
    """
    named, unnamed = searched.named_things or 0, searched.unnamed_things
    return unnamed / (named + 2 * unnamed) if unnamed else 0.0
