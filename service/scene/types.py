"""The trained scene in memory: arrays only, no torch, no files."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fastsplat.service.common.dictionary import Dictionary, label_key
from fastsplat.service.common.sh_degree import MAX_SH_DEGREE
from fastsplat.service.scene.alignment import Alignment
from fastsplat.service.scene.scaling import Scaling
from fastsplat.service.scene.suggestions import SaidName
from fastsplat.service.scene.suggestions import Suggestion as Suggestion
from fastsplat.service.scene.upright import up_of, vertical_of
from fastsplat_contract.camera import PosedCamera
from fastsplat_contract.observation_messages import Observation
from fastsplat_contract.scenes import Scale, SceneVertical
from fastsplat_contract.thing_messages import NameSource as NameSource
from fastsplat_contract.thing_reads import ThingRead

F32 = NDArray[np.float32]

SH_COUNTS = tuple((degree + 1) ** 2 for degree in range(MAX_SH_DEGREE + 1))
"""Coefficients of a color by degree: 1, 4, 9, 16."""

SH_C0 = 0.28209479177387814
"""Y_00, the constant real spherical harmonic: ½ √(1/π)."""


@dataclass(frozen=True)
class Gaussians:
    """G Gaussians; row number = Gaussian id for ever. Stored as trained, before activation, as in 3DGS files.

    Attributes:
        means: float32 [G, 3], world frame, scene units.
        quats: float32 [G, 4], rotation world-from-Gaussian as w x y z, any non-zero length.
        log_scales: float32 [G, 3], natural log of the standard deviations, scene units.
        logit_opacities: float32 [G].
        sh: float32 [G, K, 3], real spherical harmonics of RGB, K = (degree + 1)², coefficient 0 first, 3DGS sign
            convention; color = max(0, 0.5 + Σ_k Y_k(direction) sh_k).
        codes: float32 [G, D], the semantic codes (FAST-Splat's β); D may be 0 for a scene without labels.
    """

    means: F32
    quats: F32
    log_scales: F32
    logit_opacities: F32
    sh: F32
    codes: F32

    def __post_init__(self) -> None:
        count = len(self.means)
        assert self.means.shape == (count, 3) and self.quats.shape == (count, 4)
        assert self.log_scales.shape == (count, 3) and self.logit_opacities.shape == (count,)
        assert self.sh.ndim == 3 and self.sh.shape[0] == count and self.sh.shape[1] in SH_COUNTS
        assert self.sh.shape[2] == 3 and self.codes.ndim == 2 and self.codes.shape[0] == count

    def __len__(self) -> int:
        return len(self.means)

    @property
    def sh_degree(self) -> int:
        """0..`MAX_SH_DEGREE`."""
        return math.isqrt(self.sh.shape[1]) - 1


@dataclass(frozen=True)
class SemanticHead:
    """The paper's affine map W from a code to one logit per class; class 0 is undetected, class n is dictionary id n.

    Attributes:
        weight: float32 [N + 1, D].
        bias: float32 [N + 1].
    """

    weight: F32
    bias: F32

    @staticmethod
    def unlearnt(labels: int, code: int = 0) -> SemanticHead:
        """Of a scene in which no code says a label: N labels, and codes of so many numbers."""
        return SemanticHead(np.zeros((labels + 1, code), np.float32), np.zeros(labels + 1, np.float32))


@dataclass(frozen=True)
class Evidence:
    """What the label maps say of each Gaussian: A[g, n] = Σ_views Σ_pixels w·1[label = n], w the blend weight
    (FlashSplat, Shen et al. 2024), as sparse counts. Integers, so that views can be added and taken away exactly.

    Attributes:
        starts: int64 [G + 1]; row g has the entries starts[g]..starts[g + 1] of the other two.
        labels: uint16 [M], dictionary ids, ascending within a row, 0 = undetected.
        counts: int64 [M], positive, in units of 1/4096 pixel.
    """

    starts: NDArray[np.int64]
    labels: NDArray[np.uint16]
    counts: NDArray[np.int64]

    def __post_init__(self) -> None:
        assert self.starts.ndim == 1 and len(self.starts) >= 1 and self.starts.dtype == np.int64
        assert self.labels.ndim == 1 and self.labels.dtype == np.uint16
        assert self.counts.shape == self.labels.shape and self.counts.dtype == np.int64
        assert self.starts[0] == 0 and self.starts[-1] == len(self.labels)

    def __len__(self) -> int:
        return len(self.starts) - 1


STATED_FROM = 0.95
"""Probability from which a detector's name is stated without a word of doubt."""

SurfaceKind = Literal["", "floor", "ceiling", "wall", "horizontal surface", "surface"]
"""What a thing is by its geometry: "" is no surface, "surface" one that gravity says nothing of."""


class Looks(NamedTuple):
    """What a thing looks like to an image-text model.

    Attributes:
        sha256: of the model, in hex; embeddings of other models say nothing.
        embedding: float16 [E] of unit length, the mean over the pictures that show the thing best.
    """

    sha256: str
    embedding: bytes


@dataclass(frozen=True)
class Thing:
    """One physical object or surface, or a part of one.

    Attributes:
        id: 1..65535, stable: no other thing of any version of the scene, and no part, has it.
        name: "" for a thing without one.
        source: who named it; None without a name.
        probability: that the name is right, 0..1; 0 without a name.
        consensus: share of the views that see it in which it was proposed, 0..1; 1 for a thing that somebody added.
        surface: see `SurfaceKind`.
        suggestions: names that nobody has settled, with who says so, the most probable first. Those of a thing that a
            person named stay: they tell how far their sources can be trusted.
        parent: of a part, the id of the thing that it is a part of; 0 for a thing.
        proposed_in: numbers of the scene's cameras, from 0, in which it was proposed when it was discovered; empty
            where that was not noted, as for what somebody added.
        missed_in: numbers of the cameras that saw most of it then, and in which it was not proposed.
        appearance: its descriptor, float16 of length 1 (see `service.perception.appearance`); empty for a thing that no
            photo shows well, or that was made by an edit.
        picture: a small JPEG of it, empty where `appearance` is.
        reads: what is written on it, the surest first; see `service.scene.reads`.
        looks: None where no such model looked at it, no photo shows it well, or it was made by an edit.
    """

    id: int
    name: str = ""
    source: NameSource | None = None
    probability: float = 0.0
    consensus: float = 1.0
    surface: SurfaceKind = ""
    suggestions: tuple[Suggestion, ...] = ()
    parent: int = 0
    appearance: bytes = field(default=b"", repr=False)
    picture: bytes = field(default=b"", repr=False)
    proposed_in: tuple[int, ...] = ()
    missed_in: tuple[int, ...] = ()
    reads: tuple[ThingRead, ...] = ()
    looks: Looks | None = field(default=None, repr=False)

    def __post_init__(self) -> None:
        assert 1 <= self.id <= 65535 and bool(self.name) == (self.source is not None)
        assert 0 <= self.probability <= 1 and 0 <= self.consensus <= 1
        assert all(0 <= each.probability <= 1 for each in self.suggestions)
        assert all(0 <= each.probability <= 1 for each in self.reads)

    @property
    def said(self) -> tuple[SaidName, ...]:
        """What sources other than the scene's own models said of a thing that a person named, empty for others: names
        that were suggested for it, whether or not the person took one of them."""
        if self.source != "person":
            return ()
        name = label_key(self.name)
        return tuple(
            SaidName(each.source, each.probability, name in map(label_key, (each.name, *each.aliases)))
            for each in self.suggestions
            if each.source
        )

    @property
    def guessed(self) -> bool:
        """Whether its name is a detector's, and not probable enough to be stated."""
        return self.source == "detected" and self.probability < STATED_FROM


@dataclass(frozen=True)
class Parts:
    """Parts of things, and which Gaussians they have; a Gaussian of a part is of the part's thing as well.

    Attributes:
        table: by ascending id, each with its `parent`.
        membership: of G Gaussians; its labels are ids of parts, 0 = no part. A Gaussian without entries is of none.
    """

    table: tuple[Thing, ...]
    membership: Evidence

    def __post_init__(self) -> None:
        ids = [part.id for part in self.table]
        assert ids == sorted(set(ids)) and all(part.parent for part in self.table)


@dataclass(frozen=True)
class ThingGroup:
    """Several things that views took for one, as the books of a stack.

    Attributes:
        id: 1..65535, of the same numbers as the things' and parts' ids.
        members: ids of two or more things, ascending.
        consensus: share of the views that see it in which it was proposed, 0..1.
    """

    id: int
    members: tuple[int, ...]
    consensus: float

    def __post_init__(self) -> None:
        assert 1 <= self.id <= 65535 and 0 <= self.consensus <= 1
        assert len(self.members) >= 2 and list(self.members) == sorted(set(self.members))


@dataclass(frozen=True)
class Things:
    """Every thing of a scene, and which Gaussians it has.

    Attributes:
        table: by ascending id.
        membership: of G Gaussians; its labels are ids of things, 0 = no thing, its counts how sure that is.
        next_id: no thing of this version of the scene, or of those it was made of, and no part or group has this id or
            a larger one; 0 stands for the one after the last.
        parts: of the things; None for none.
        head: maps the Gaussians' codes to logits over things, and decides whose pixel it is; see `codes_of_things`.
            None where no codes were trained on the things: then the blended membership decides.
        groups: of the things, by ascending id; a thing may be in several.
    """

    table: tuple[Thing, ...]
    membership: Evidence
    next_id: int = 0
    parts: Parts | None = None
    head: SemanticHead | None = None
    groups: tuple[ThingGroup, ...] = ()

    def __post_init__(self) -> None:
        ids = [thing.id for thing in self.table]
        assert ids == sorted(set(ids)) and not any(thing.parent for thing in self.table)
        if self.parts is not None:
            assert len(self.parts.membership) == len(self.membership)
            assert not {part.id for part in self.parts.table} & set(ids)
            assert {part.parent for part in self.parts.table} <= set(ids)
        group_ids = [group.id for group in self.groups]
        assert group_ids == sorted(set(group_ids)) and not {thing.id for thing in self.everything} & set(group_ids)
        assert all(set(group.members) <= set(ids) for group in self.groups)

    @property
    def everything(self) -> tuple[Thing, ...]:
        """The things, then the parts."""
        return self.table if self.parts is None else (*self.table, *self.parts.table)


@dataclass(frozen=True)
class CodeSemantics:
    """Labels of G Gaussians as their semantic codes.

    Attributes:
        codes: float32 [G, D].
        head: the affine map from a code to one logit per class.
    """

    codes: F32
    head: SemanticHead


@dataclass(frozen=True)
class ThingSemantics:
    """Labels of G Gaussians as the names of the things that they belong to.

    Attributes:
        things: their membership says which.
        codes: float32 [G, D], see `Things.head`.
        label_ids: int32 [I + 1], by id of a thing up to the largest id I: the dictionary id of the thing's name, 0 for
            a thing without one, and for 0, no thing.
    """

    things: Things
    codes: F32
    label_ids: NDArray[np.int32]


Semantics = CodeSemantics | Evidence | ThingSemantics
"""What the labels of Gaussians are made from, see `semantics_of`."""

LabelMode = Literal["codes", "evidence", "things"]
"""What says which label a Gaussian has: its code under the affine map W, what the label maps showed of it, or the name
of the thing that it belongs to."""


TAKEN_AT = "taken_at"
"""In a scene's quality: when its photos were taken, by the names of their cameras, seconds since 1970."""


@dataclass(frozen=True)
class Scene:
    """Everything a query needs.

    Attributes:
        gaussians: see `Gaussians`.
        head: maps codes to logits over `dictionary` and undetected.
        dictionary: N labels.
        label_embeddings: float32 [N, E], unit length, in dictionary order, by `text_encoder`.
        text_encoder: manifest name of the encoder, and the sha256 of its weights.
        cameras: the training and held-out views.
        scale: whether scene units are meters.
        training: the settings it was trained with, JSON-ready.
        quality: measured figures (psnr, ssim, images, registered, stage_seconds, ...), JSON-ready.
        label_templates: the sentences the labels were embedded in (mean over them); "{}" is the bare label.
        evidence: sparse label counts of the same Gaussians, or None.
        things: of the same Gaussians, or None for a scene that stores none; what its things are then, says
            `fastsplat.service.query.things.labeled_things`.
        scaling: by which known lengths it was scaled since it was trained; None if it was not.
        alignment: how it was put into the frame of a map since; None if it was not.
        observations: what photos of other days said of it, in the order in which they came; in the frame of the trained
            version, see `fastsplat.service.scene.observations`.
    """

    gaussians: Gaussians
    head: SemanticHead
    dictionary: Dictionary
    label_embeddings: F32
    text_encoder: tuple[str, str]
    cameras: tuple[PosedCamera, ...]
    scale: Scale
    training: Mapping[str, Any] = field(default_factory=dict)
    quality: Mapping[str, Any] = field(default_factory=dict)
    label_templates: tuple[str, ...] = ("{}",)
    evidence: Evidence | None = None
    things: Things | None = None
    scaling: Scaling | None = None
    alignment: Alignment | None = None
    observations: tuple[Observation, ...] = ()

    def __post_init__(self) -> None:
        classes = len(self.dictionary) + 1
        assert self.head.weight.shape == (classes, self.gaussians.codes.shape[1]) and self.head.bias.shape == (classes,)
        assert self.label_embeddings.ndim == 2 and self.label_embeddings.shape[0] == len(self.dictionary)
        assert self.evidence is None or len(self.evidence) == len(self.gaussians)
        if self.things is not None:
            assert len(self.things.membership) == len(self.gaussians)
            head = self.things.head
            assert head is None or head.weight.shape == (len(head.bias), self.gaussians.codes.shape[1] or -1)

    @property
    def label_mode(self) -> LabelMode:
        """What says which label a Gaussian has: its thing where the scene stores things, else evidence where it has
        some, else its code."""
        return "things" if self.things is not None else "codes" if self.evidence is None else "evidence"

    def vertical(self) -> SceneVertical | None:
        """Which way is up in this version's frame, by what, and how sure that is; see `vertical_of`."""
        return vertical_of(self.quality, self.alignment, self.cameras)

    def up(self) -> NDArray[np.float64] | None:
        """float64 [3], the unit vector up in this version's frame; None where nothing tells it well enough, see
        `up_of`."""
        return up_of(self.vertical())


def semantics_of(scene: Scene) -> Semantics:
    """What says which label each Gaussian has, see `Scene.label_mode`: the name of its thing, the evidence of the label
    maps, or its code."""
    if scene.things is not None:
        label_ids = np.zeros(max((thing.id for thing in scene.things.table), default=0) + 1, np.int32)
        for thing in scene.things.table:
            label_ids[thing.id] = (scene.dictionary.id_of(thing.name) or 0) if thing.name else 0
        return ThingSemantics(scene.things, scene.gaussians.codes, label_ids)
    if scene.evidence is not None:
        return scene.evidence
    return CodeSemantics(scene.gaussians.codes, scene.head)
