"""Settings of discovery: things without a vocabulary."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from fastsplat.service.common.setting_groups import Options, SettingGroup


class DiscoveryOptions(Options):
    """Which things of several views are the same."""

    max_side: int = Field(640, ge=64)
    """Masks are lifted at this many pixels on the image's longer side."""
    min_overlap: float = Field(0.5, gt=0, lt=1)
    """What overlaps at least so much is the same thing: a mask of a view and a thing, or two things."""
    min_views: int = Field(2, ge=1)
    """Views that must propose a thing; never more than there are."""
    min_weight_px: float = Field(100.0, ge=0)
    """Things that fill fewer pixels of a view on average are none."""
    refinement_rounds: int = Field(2, ge=0)
    """Rounds in which things take the masks of the views that they match, and Gaussians count the masks' pixels; 0: the
    views vote on whole Gaussians alone."""


class DiscoverySettings(DiscoveryOptions, SettingGroup, section="discovery"):
    """How things are discovered without a vocabulary, and when they count."""

    things: Literal["auto", "off", "on"] = "auto"
    """Which things a scene gets. `auto`: everything in it where models label its views, else the label maps' objects.
    `on`: everything. `off`: what the detector finds, which saves most of a segmenter's time."""

    def proposes(self, *, given_labels: bool) -> bool:
        """Whether masks without names are proposed in a capture's views, which may come with label maps."""
        return self.things == "on" or (self.things == "auto" and not given_labels)


class LookAgainOptions(Options):
    """How a finished scene is looked at again for more names."""

    views: int = Field(8, ge=1)
    """Views that an open-set detector looks at: those that see most of the scene, and of its unnamed things first."""
    closer_views: int = Field(4, ge=0)
    """Of these views, so many that show a thing best are looked at around it alone (small things); 0: none."""
    name_probability: float = Field(0.45, ge=0, le=1)
    """A text is stated as a thing's name from this mean score over the pictures that show the thing; below, it is a
    suggestion. Chosen on the table of the tests with a YOLO-World detector; detectors score differently."""


class PromptOptions(Options):
    """How a thing that somebody points at in one view is segmented, there and in others."""

    views: int = Field(3, ge=1)
    """Views that are rendered and segmented, the one that was pointed at included; each takes about a second."""
    max_side: int = Field(640, ge=64)
    """They are rendered at this many pixels on the longer side, and never larger than they are."""
