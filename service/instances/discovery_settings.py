"""Settings of discovery: objects without a vocabulary."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from fastsplat.service.common.setting_groups import Options, SettingGroup


class DiscoveryOptions(Options):
    """Which objects of several views are the same."""

    max_side: int = Field(640, ge=64)
    """Masks are lifted at this many pixels on the image's longer side."""
    min_overlap: float = Field(0.5, gt=0, lt=1)
    """What overlaps at least so much is the same object: a mask of a view and an object, or two objects."""
    min_views: int = Field(2, ge=1)
    """Views that must propose an object; never more than there are."""
    min_weight_px: float = Field(100.0, ge=0)
    """Objects that fill fewer pixels of a view on average are none."""
    refinement_rounds: int = Field(2, ge=0)
    """Rounds in which objects take the masks of the views that they match, and Gaussians count the masks' pixels; 0:
    the views vote on whole Gaussians alone."""


class DiscoverySettings(DiscoveryOptions, SettingGroup, section="discovery"):
    """How objects are discovered without a vocabulary, and when they count."""

    objects: Literal["auto", "off", "on"] = "auto"
    """Which objects a scene gets. `auto`: everything in it where models label its views, else the label maps' objects.
    `on`: everything. `off`: what the detector finds, which saves most of a segmenter's time."""

    def proposes(self, *, given_labels: bool) -> bool:
        """Whether masks without names are proposed in a capture's views, which may come with label maps."""
        return self.objects == "on" or (self.objects == "auto" and not given_labels)


class LookAgainOptions(Options):
    """How a finished scene is looked at again for more names."""

    views: int = Field(8, ge=1)
    """Views that an open-set detector looks at: those that see most of the scene, and of its unnamed objects first."""
    closer_views: int = Field(4, ge=0)
    """Of these views, so many that show an object best are looked at around it alone (small objects); 0: none."""


class PromptOptions(Options):
    """How an object that somebody points at in one view is segmented, there and in others."""

    views: int = Field(3, ge=1)
    """Views that are rendered and segmented, the one that was pointed at included; each takes about a second."""
    max_side: int = Field(640, ge=64)
    """They are rendered at this many pixels on the longer side, and never larger than they are."""
