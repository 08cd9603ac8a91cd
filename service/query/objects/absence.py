"""Evidence for absence: names searched for, nameless objects and unseen space."""

from __future__ import annotations

from dataclasses import dataclass

from fastsplat_contract.geometry.poses import Vector3
from fastsplat_contract.messages.queries import Searched

RATHER = 0.5
"""Least probability of a definite answer, either way; below, only "probably" or "cannot say"."""

HIDES = 0.07
"""Least unseen share of a place for an absent object to be possibly hidden."""


USUAL_M = 0.22
"""Width of an object of usual size, meters; chosen on drawn rooms, see docs/asking.md."""


@dataclass(frozen=True)
class Hollow:
    """The largest unseen space inside an object."""

    object_id: int  # its id, or that of the label where no objects are stored
    volume: float  # scene units cubed
    width: float  # of the largest ball that fits into it, scene units
    middle: Vector3  # of that ball, world frame
    view: str = ""  # the camera nearest to it that has it in the picture; "" for none


@dataclass(frozen=True)
class UnseenSpace:
    """Unseen space of a place, see `unseen_space`."""

    share: float  # 0..1, of the space between the objects
    behind: tuple[int, ...]  # ids of objects (labels if none are stored) that hide most of it, most first
    middle: Vector3 | None = None  # of the largest ball between objects, world; None if `share` is 0
    hollows: tuple[Hollow, ...] = ()  # of objects, whether they are hollow or solid, the largest first
    meter: float = 1.0  # scene units per meter; non-metric: half of the objects count as up to `USUAL_M` long
    in_meters: bool = False  # whether the scene has meters

    @property
    def hides(self) -> bool:
        """True if enough is unseen for a missing object to be there."""
        return self.share >= HIDES


ALL_SEEN = UnseenSpace(0.0, ())


def unnamed_probability(searched: Searched) -> float:
    """Probability 0..1 that a nameless object answers, if no named one does.

    The prior for the object being in the scene is 1/2, uniform over objects. Excluding the n named objects leaves (u /
    (n + u)) / (u / (n + u) + 1) = u / (n + 2u) for the u nameless ones."""
    named, unnamed = searched.named_objects or 0, searched.unnamed_objects
    return unnamed / (named + 2 * unnamed) if unnamed else 0.0
