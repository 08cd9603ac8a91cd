"""In-memory scene types: NumPy arrays only, no torch, no files."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from fastsplat.service.common.dictionary import Dictionary, label_key
from fastsplat.service.common.sh_degree import MAX_SH_DEGREE
from fastsplat.service.scene.artefact.alignment import Alignment, frame_name
from fastsplat.service.scene.artefact.scaling import Scaling
from fastsplat.service.scene.artefact.scene_facts import SceneFacts as SceneFacts
from fastsplat.service.scene.artefact.suggestions import SaidName
from fastsplat.service.scene.artefact.suggestions import Suggestion as Suggestion
from fastsplat.service.scene.artefact.upright import up_of, vertical_of
from fastsplat_contract.geometry.camera import PosedCamera
from fastsplat_contract.messages.object_reads import ObjectRead
from fastsplat_contract.messages.objects import NameSource as NameSource
from fastsplat_contract.messages.scenes import Scale, SceneVertical
from fastsplat_contract.photos.observations import Observation

F32 = NDArray[np.float32]

SH_COUNTS = tuple((degree + 1) ** 2 for degree in range(MAX_SH_DEGREE + 1))
"""SH coefficients per channel by degree: 1, 4, 9, 16."""

SH_C0 = 0.28209479177387814
"""Y_00, the constant real spherical harmonic: ½ √(1/π)."""


@dataclass(frozen=True)
class Gaussians:
    """G Gaussians before activation, as in 3DGS files; the row number is the permanent id.

    color = max(0, 0.5 + Σ_k Y_k(direction) sh_k), real spherical harmonics, K = (degree + 1)², 3DGS sign convention.
    """

    means: F32  # [G, 3], world frame, scene units
    quats: F32  # [G, 4], world-from-Gaussian rotation as w x y z, any non-zero length
    log_scales: F32  # [G, 3], natural log of the standard deviations, scene units
    logit_opacities: F32  # [G]
    sh: F32  # [G, K, 3], RGB
    codes: F32  # [G, D], semantic codes (FAST-Splat's β); D may be 0 for a scene without labels

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
    """Affine map W of the paper from codes to class logits; class 0 is undetected, class n is dictionary id n."""

    weight: F32  # [N + 1, D]
    bias: F32  # [N + 1]

    @staticmethod
    def unlearnt(labels: int, code: int = 0) -> SemanticHead:
        """A zero head for N labels and codes of `code` dimensions."""
        return SemanticHead(np.zeros((labels + 1, code), np.float32), np.zeros(labels + 1, np.float32))

    def grown(self) -> SemanticHead:
        """Adds a label that no code activates."""
        weight = np.concatenate([self.weight, np.zeros((1, self.weight.shape[1]), np.float32)])
        return SemanticHead(weight, np.append(self.bias, np.float32(-1e4)).astype(np.float32))


@dataclass(frozen=True)
class Evidence:
    """Sparse label counts per Gaussian, integers so that views can be removed exactly.

    A[g, n] = Σ_views Σ_pixels w·1[label = n] with blend weight w (FlashSplat, Shen et al. 2024).
    """

    starts: NDArray[np.int64]  # [G + 1]; row g has the entries starts[g]..starts[g + 1] of the other two
    labels: NDArray[np.uint16]  # [M], dictionary ids, ascending within a row, 0 = undetected
    counts: NDArray[np.int64]  # [M], positive, in units of 1/4096 pixel

    def __post_init__(self) -> None:
        assert self.starts.ndim == 1 and len(self.starts) >= 1 and self.starts.dtype == np.int64
        assert self.labels.ndim == 1 and self.labels.dtype == np.uint16
        assert self.counts.shape == self.labels.shape and self.counts.dtype == np.int64
        assert self.starts[0] == 0 and self.starts[-1] == len(self.labels)

    def __len__(self) -> int:
        return len(self.starts) - 1


STATED_FROM = 0.95
"""Probability from which a detected name is stated without qualification."""

SurfaceKind = Literal["", "floor", "ceiling", "wall", "horizontal surface", "surface"]
"""Geometric kind of an object: "" is no surface, "surface" has no known orientation."""


class Looks(NamedTuple):
    """Image-text embedding of an object."""

    sha256: str  # of the model, in hex; embeddings of different models are not comparable
    embedding: bytes  # float16 [E] of unit length, the mean over the best pictures of the object


@dataclass(frozen=True)
class Object:
    """A physical object or surface, or a part of one.

    Attributes:
        id: 1..65535, never reused by another object or part in any version of the scene.
        consensus: share of the views seeing it in which it was proposed, 0..1; 1 for an object added by an edit.
        suggestions: unconfirmed names, most probable first. Kept after a person names the object, to rate the sources.
        appearance: descriptor, float16 of unit length (`service.perception.appearance`). Empty, like `picture` and
            `looks`, if no photo shows the object well, or it was made by an edit.
        proposed_in: camera indices in which discovery proposed it; empty if not recorded, e.g. for objects added by an
            edit.
        missed_in: camera indices that saw most of it during discovery without proposing it.
    """

    id: int
    name: str = ""
    source: NameSource | None = None  # None if unnamed
    probability: float = 0.0  # of the name
    consensus: float = 1.0
    surface: SurfaceKind = ""
    suggestions: tuple[Suggestion, ...] = ()
    parent: int = 0  # of a part, its object's id
    appearance: bytes = field(default=b"", repr=False)
    picture: bytes = field(default=b"", repr=False)  # small JPEG
    proposed_in: tuple[int, ...] = ()
    missed_in: tuple[int, ...] = ()
    reads: tuple[ObjectRead, ...] = ()  # surest first
    looks: Looks | None = field(default=None, repr=False)

    def __post_init__(self) -> None:
        assert 1 <= self.id <= 65535 and bool(self.name) == (self.source is not None)
        assert 0 <= self.probability <= 1 and 0 <= self.consensus <= 1
        assert all(0 <= suggestion.probability <= 1 for suggestion in self.suggestions)
        assert all(0 <= read.probability <= 1 for read in self.reads)

    @property
    def said(self) -> tuple[SaidName, ...]:
        """Other sources' suggestions for an object that a person named; otherwise empty."""
        if self.source != "person":
            return ()
        name = label_key(self.name)
        spoken = [said for said in self.suggestions if said.source]
        right = [name in map(label_key, (said.name, *said.aliases)) for said in spoken]
        return tuple(SaidName(said.source, said.probability, ok) for said, ok in zip(spoken, right, strict=True))

    @property
    def guessed(self) -> bool:
        """The name was detected and is not probable enough to be stated."""
        return self.source == "detected" and self.probability < STATED_FROM


@dataclass(frozen=True)
class Parts:
    """Parts of objects; a part's Gaussians belong to its object as well."""

    table: tuple[Object, ...]  # by ascending id, each with its `parent`
    membership: Evidence  # labels are part ids, 0 = no part, as for Gaussians without entries

    def __post_init__(self) -> None:
        ids = [part.id for part in self.table]
        assert ids == sorted(set(ids)) and all(part.parent for part in self.table)


@dataclass(frozen=True)
class ObjectGroup:
    """Objects that views proposed as one, e.g. a stack of books."""

    id: int  # 1..65535, distinct from ids of objects and parts
    members: tuple[int, ...]  # two or more, ascending
    consensus: float  # share of the views seeing it in which it was proposed, 0..1

    def __post_init__(self) -> None:
        ascending = len(self.members) >= 2 and list(self.members) == sorted(set(self.members))
        if not (1 <= self.id <= 65535 and 0 <= self.consensus <= 1 and ascending):
            raise ValueError(f"{self} is no group of two objects or more")


@dataclass(frozen=True)
class Objects:
    """Objects of a scene and their Gaussians.

    Attributes:
        membership: of G Gaussians; labels are object ids, 0 = no object, counts the strength of the evidence.
        next_id: above all ids of objects, parts and groups of this version and its predecessors; 0 derives it from the
            present ids.
        head: maps codes to logits over objects and decides a pixel's owner (`codes_of_objects`). None without trained
            codes: then the blended membership decides.
    """

    table: tuple[Object, ...]  # by ascending id
    membership: Evidence
    next_id: int = 0
    parts: Parts | None = None
    head: SemanticHead | None = None
    groups: tuple[ObjectGroup, ...] = ()  # by ascending id; an object may be in several

    def __post_init__(self) -> None:
        ids = [obj.id for obj in self.table]
        assert ids == sorted(set(ids)) and not any(obj.parent for obj in self.table)
        if self.parts is not None:
            assert len(self.parts.membership) == len(self.membership)
            assert not {part.id for part in self.parts.table} & set(ids)
            assert {part.parent for part in self.parts.table} <= set(ids)
        group_ids = [group.id for group in self.groups]
        assert group_ids == sorted(set(group_ids)) and not {obj.id for obj in self.everything} & set(group_ids)
        assert all(set(group.members) <= set(ids) for group in self.groups)

    @property
    def everything(self) -> tuple[Object, ...]:
        return self.table if self.parts is None else (*self.table, *self.parts.table)


@dataclass(frozen=True)
class CodeSemantics:
    """Labels of Gaussians by their semantic codes."""

    codes: F32  # [G, D]
    head: SemanticHead


@dataclass(frozen=True)
class ObjectSemantics:
    """Labels of Gaussians by the names of their objects."""

    objects: Objects
    codes: F32  # [G, D], see `Objects.head`
    label_ids: NDArray[np.int32]  # [I + 1], dictionary id by object id up to the largest, I; 0 if unnamed or no object


Semantics = CodeSemantics | Evidence | ObjectSemantics
"""Source of the Gaussians' labels."""

LabelMode = Literal["codes", "evidence", "objects"]
"""Source of a Gaussian's label: its code, label map evidence, or its object's name."""


@dataclass(frozen=True)
class Scene:
    """A trained scene version.

    Attributes:
        label_templates: sentences the labels were embedded in (mean over them); "{}" is the bare label.
        objects: None if none are stored; see `fastsplat.service.query.objects.labeled_objects` for that case.
        observations: from photos of other days, in order of arrival, in the trained version's frame
            (`fastsplat.service.scene.artefact.observations`).
    """

    gaussians: Gaussians
    head: SemanticHead  # logits over `dictionary` and undetected
    dictionary: Dictionary
    label_embeddings: F32  # [N, E], unit length, in dictionary order, by `text_encoder`
    text_encoder: tuple[str, str]  # manifest name and sha256 of the weights
    cameras: tuple[PosedCamera, ...]  # training and held-out views
    scale: Scale  # whether scene units are meters
    training: Mapping[str, Any] = field(default_factory=dict)  # settings, JSON-ready
    quality: Mapping[str, Any] = field(default_factory=dict)  # measurements (psnr, images, ...), JSON-ready
    facts: SceneFacts = field(default_factory=SceneFacts)
    label_templates: tuple[str, ...] = ("{}",)
    evidence: Evidence | None = None
    objects: Objects | None = None
    scaling: Scaling | None = None  # by known lengths since training
    alignment: Alignment | None = None  # to a map since training
    observations: tuple[Observation, ...] = ()

    def __post_init__(self) -> None:
        classes = len(self.dictionary) + 1
        assert self.head.weight.shape == (classes, self.gaussians.codes.shape[1]) and self.head.bias.shape == (classes,)
        assert self.label_embeddings.ndim == 2 and self.label_embeddings.shape[0] == len(self.dictionary)
        assert self.evidence is None or len(self.evidence) == len(self.gaussians)
        if self.objects is not None:
            assert len(self.objects.membership) == len(self.gaussians)
            head = self.objects.head
            assert head is None or head.weight.shape == (len(head.bias), self.gaussians.codes.shape[1] or -1)

    @property
    def label_mode(self) -> LabelMode:
        """Objects if the scene stores them, else evidence, else codes."""
        return "objects" if self.objects is not None else "codes" if self.evidence is None else "evidence"

    @property
    def frame_id(self) -> str:
        """Name of the world frame, see `frame_name`."""
        return frame_name(self.alignment)

    def with_objects(self, objects: Objects) -> ObjectScene:
        """Stores objects in the scene, in place of its own."""
        return ObjectScene(**{**vars(self), "objects": objects})

    def semantics(self) -> Semantics:
        """Returns the source of the Gaussians' labels selected by `label_mode`."""
        if self.objects is not None:
            label_ids = np.zeros(max((obj.id for obj in self.objects.table), default=0) + 1, np.int32)
            for obj in self.objects.table:
                label_ids[obj.id] = (self.dictionary.id_of(obj.name) or 0) if obj.name else 0
            return ObjectSemantics(self.objects, self.gaussians.codes, label_ids)
        if self.evidence is not None:
            return self.evidence
        return CodeSemantics(self.gaussians.codes, self.head)

    def vertical(self) -> SceneVertical | None:
        """Vertical direction in this version's frame, its source and uncertainty."""
        return vertical_of(self.facts, self.alignment, self.cameras)

    def up(self) -> NDArray[np.float64] | None:
        """Unit up vector in this version's frame, float64 [3]; None if too uncertain."""
        return up_of(self.vertical())


@dataclass(frozen=True)
class ObjectScene(Scene):
    """A scene version that stores its objects."""

    objects: Objects = field(kw_only=True)


SceneT = TypeVar("SceneT", bound=Scene)
