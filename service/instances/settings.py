"""Settings of discovery: things without a vocabulary."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from fastsplat.service.common.settings import SettingGroup


class DiscoverySettings(SettingGroup, section="discovery"):
    """How things are discovered without a vocabulary, and when they count."""

    things: Literal["auto", "off", "on"] = "auto"
    """Whether a scene gets things: everything in it, with or without a name. `auto`: where models label its views;
    where label maps came with the capture, their objects are its things and no model runs. `on`: there too."""
    max_side: int = Field(640, ge=64)
    """Masks are lifted at this many pixels on the image's longer side."""

    min_overlap: float = Field(0.5, gt=0, lt=1)
    """Proposals of two views that overlap more are the same thing."""
    min_views: int = Field(2, ge=1)
    """Views that must propose a thing; never more than there are."""
    min_view_share: float = Field(0.1, ge=0, le=1)
    """As `min_views`, as a share of all views."""
    min_consensus: float = Field(0.45, ge=0, le=1)
    """Share of the views that see a thing that must propose it."""
    nested_score: float = Field(0.77, ge=0, le=1)
    """What lies inside a larger thing is a thing of its own from this consensus times quality, and its part below."""
    min_weight_px: float = Field(100.0, ge=0)
    """Things that fill fewer pixels of a view on average are none."""

    surface_share: float = Field(0.015, ge=0, le=1)
    """Flat things that fill this share of what is visible are surfaces."""
    surface_flatness: float = Field(0.25, gt=0)
    """The tolerance of a surface's plane is at most this share of its extent."""
    piece_consensus: float = Field(0.8, ge=0, le=1)
    """What lies in the plane of a surface and is proposed by fewer of the views is a piece of the surface."""

    unexplained_consensus: float = Field(0.25, ge=0, le=1)
    """A candidate whose Gaussians no thing owns is a thing from this consensus."""
    unexplained_share: float = Field(0.7, ge=0, le=1)
    """Share of a candidate's weight that no thing owns, for that."""
    weak_share: float = Field(0.2, ge=0, le=1)
    """A Gaussian that nobody owns belongs to the thing that most views count it to, from this share of them."""
    neighbors: int = Field(8, ge=1)
    """What then nobody owns belongs to the thing that most of so many nearest Gaussians belong to."""
    stray_share: float = Field(0.1, ge=0, le=1)
    """Pieces of a thing that touch nothing of it and weigh less than this share of its largest piece are left out."""
    refinement_rounds: int = Field(2, ge=0)
    """Rounds in which things take the masks of the views that they match, and Gaussians count the masks' pixels; 0: the
    views vote on whole Gaussians alone."""

    name_overlap: float = Field(0.5, gt=0, le=1)
    """A region names the thing that it overlaps this much in its view."""
    name_probability: float = Field(0.28, ge=0, le=1)
    """A name is stated from this mean score over the views that see the thing; below, it is a suggestion. Chosen on the
    demo's sample, whose books have 0.30; on a table top of the tests the first wrong name has 0.27."""
    name_rivals: float = Field(0.5, ge=0, le=1)
    """A name is stated only where no other has more than this share of its score."""
    name_size_ratio: float = Field(1.6, ge=1)
    """A detected name that things bear of which one is so many times as large as another is a class that the detector
    puts everything into: then it is a suggestion for all of them. Names that were asked for are spared."""

    def proposes(self, *, given_labels: bool) -> bool:
        """Whether masks without names are proposed in a capture's views, which may come with label maps."""
        return self.things == "on" or (self.things == "auto" and not given_labels)


class LookAgainSettings(SettingGroup, section="look_again"):
    """How a finished scene is looked at again for more names."""

    views: int = Field(8, ge=1)
    """Views that an open-set detector looks at: those that see most of the scene, and of its unnamed things first."""
    candidates: int = Field(60, ge=1)
    """Of so many of the scene's cameras, evenly spread, these views are chosen; each costs one rasterization."""
    picture_side: int = Field(1024, ge=64)
    """Pixels of the longer side of the pictures that are rendered, never more than the camera has."""
    closer_views: int = Field(4, ge=0)
    """Of these views, for each thing, so many that show it best are looked at around the thing alone; 0: none. Small
    things are found by this."""
    closer_side: int = Field(640, ge=64)
    """Pixels of the longer side of such a picture, never more than the camera has there."""
    name_probability: float = Field(0.45, ge=0, le=1)
    """A text is stated as a thing's name from this mean score over the pictures that show the thing; below, it is a
    suggestion. Chosen on the table of the tests with a YOLO-World detector; detectors score differently."""
