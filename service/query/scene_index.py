"""A scene that can be queried: from texts to entries, masks and objects."""

from __future__ import annotations

import threading
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from fastsplat.service.common.dictionary import Dictionary, DictionaryEntry
from fastsplat.service.query.language.meaning.embeddings import TextCaches, embed_labels, embed_names
from fastsplat.service.query.language.meaning.prompt_context import SceneLabels
from fastsplat.service.query.language.meaning.word_senses import label_meaning
from fastsplat.service.query.language.ranking import Ranker
from fastsplat.service.query.language.words.query_text import check_query
from fastsplat.service.query.objects.labeled_objects import label_by_objects, label_gaussians
from fastsplat.service.query.objects.names.look_alikes import sizes_in_meters
from fastsplat.service.query.objects.names.object_names import names_of
from fastsplat.service.query.objects.object_history import scene_history
from fastsplat.service.query.query_settings import QuerySettings
from fastsplat.service.query.ranked_scene import RankedQuery, RankedScene
from fastsplat.service.scene.artefact.scene import ObjectSemantics, Scene, SceneT, SemanticHead
from fastsplat.service.scene.gaussians.coarse import coarse_scene
from fastsplat_contract.errors import InvalidInputError, LimitExceededError, NotFoundError
from fastsplat_contract.geometry.camera import PosedCamera
from fastsplat_contract.geometry.viewpoint import WORLD
from fastsplat_contract.messages.objects import SceneObject
from fastsplat_contract.messages.queries import Answer

if TYPE_CHECKING:  # torch and onnxruntime load when they are used
    from fastsplat.service.perception.lexicon.wordnet import Lexicon
    from fastsplat.service.perception.results import TextEncoder
    from fastsplat.service.query.drawing.scene_renderer import Mask2D, Renderer
    from fastsplat.service.query.drawing.view_geometry import ViewGeometry
    from fastsplat.service.query.objects.object_index import SceneObjects
    from fastsplat.service.query.phrases.object_looks import LooksModel
    from fastsplat.service.scene.artefact.scene import ObjectScene

_MAX_IMAGE_SIDE = 4_096
"""Pixels; larger views are refused."""

_DEFAULTS = QuerySettings()
_MAX_NAMED = 20


class CoarseView:
    """Renderer of a coarse scene with objects (see `coarse_scene`) while a camera moves; thread-safe."""

    def __init__(self, scene: ObjectScene, settings: QuerySettings) -> None:
        from fastsplat.service.query.drawing.scene_renderer import Renderer
        from fastsplat.service.query.objects.object_index import SceneObjects

        renderer = Renderer(scene, settings)
        self.scene, self.render = scene, renderer.colors
        self.objects = SceneObjects(scene, True, renderer.id_map, scene_history(scene))


class SceneIndex:
    """One scene with one text encoder; thread-safe.

    An entry is *exact* if the query is its name (`NameIndex.match`), if its score reaches the encoder's exact
    threshold, or, with a lexicon, if both share a sense. Otherwise the entries above the encoder's related threshold,
    or those that the lexicon's model finds likely, are *related*: the leading one and those likely enough beside it, as
    well as entries that the query names with further words. An uncalibrated encoder without thresholds in the settings
    matches names only; its answers say so.

    All renderings raise LimitExceededError for images above 4,096 pixels a side; `mask`, `mask2d`, `mask3d` and
    `objects_of` raise InvalidInputError for answers with entries of another scene.

    Args:
        encoder: embeds queries; also re-embeds the labels if the scene's came from another encoder or other templates.
        before: index of the scene before an edit, with the same encoder, settings and lexicon, for reuse.
        lexicon: judges meanings beside the encoder where both were calibrated together; None: not used.
        looks: compares texts with the appearance of objects; None: disabled.

    Attributes:
        ranked: answers queries without keeping the Gaussians.

    Raises:
        ModelUnavailableError: the encoder returns something other than embeddings.
    """

    def __init__(
        self,
        scene: Scene,
        encoder: TextEncoder,
        settings: QuerySettings = _DEFAULTS,
        before: SceneIndex | None = None,
        lexicon: Lexicon | None = None,
        caches: TextCaches | None = None,
        looks: LooksModel | None = None,
    ) -> None:
        self.scene = scene
        self.settings = settings
        self._before = before
        self._encoder = encoder
        self._lexicon, self._looks = lexicon, looks
        self._renderer: Renderer | None = None
        self._renderer_lock = threading.Lock()
        self._coarse: CoarseView | None = None
        self._objects: SceneObjects | None = None
        self._objects_lock = threading.Lock()
        self._history = scene_history(scene)
        semantics = scene.semantics()
        if isinstance(semantics, ObjectSemantics):
            self._labels = label_by_objects(semantics, self.objects.belief)
            unseen = self.objects.unseen
        else:
            from fastsplat.service.query.objects.unseen_space import surface_kind, unseen_space

            self._labels = label_gaussians(scene)
            kinds = {
                number: surface_kind(entry.label) for number, entry in enumerate(scene.dictionary.entries, start=1)
            }
            unseen = unseen_space(scene, self._labels.classes, kinds)
        names = names_of(scene, None if scene.objects is None else self.objects.names, self.label_counts)
        known = None if before is None else before.ranked.ranker
        embeddings = np.array(scene.label_embeddings)
        labels = SceneLabels(names.dictionary, embeddings, scene.text_encoder, scene.label_templates)
        ranker = Ranker(labels, names, self.label_counts, encoder, settings, known, lexicon, caches)
        sizes = sizes_in_meters(scene, None if before is None else (before.scene, before.ranked.sizes))
        self.ranked: RankedScene = RankedScene(scene, ranker, names, unseen, self._history, looks, sizes)
        if before is not None and before._renderer is not None and before.scene.gaussians is scene.gaussians:
            self._renderer = before._renderer.relabeled(scene)
        self._before = None

    def after(self, scene: Scene) -> SceneIndex:
        """Returns the index of an edited version of this scene, reusing this one."""
        return SceneIndex(scene, self._encoder, self.settings, self, self._lexicon, looks=self._looks)

    @property
    def calibrated(self) -> bool:
        """True if thresholds exist for this encoder, so that `related` can be judged."""
        return self.ranked.ranker.calibrated

    @property
    def gaussian_classes(self) -> NDArray[np.int32]:
        """Dictionary id of each Gaussian, int32 [G]; 0 = undetected."""
        return self._labels.classes

    @cached_property
    def isolation(self) -> NDArray[np.float32]:
        """Isolation of each Gaussian, float32 [G], see `service.scene.gaussians.connectivity`."""
        from fastsplat.service.scene.gaussians.connectivity import isolation  # scipy loads with the first filter

        return isolation(self.scene.gaussians)

    @cached_property
    def label_counts(self) -> list[int]:
        """Number of Gaussians of each dictionary id, including parts of that name; [0]: undetected."""
        counts: list[int] = np.bincount(self._labels.classes, minlength=len(self.scene.dictionary) + 1).tolist()
        for label_id in self._part_labels:
            counts[label_id] = int(self.labeled((label_id,)).sum())
        return counts

    def labeled(self, label_ids: Sequence[int]) -> NDArray[np.bool_]:
        """Selects Gaussians of these labels, or in parts that bear one, bool [G]."""
        rows = np.isin(self._labels.classes, label_ids)
        parts = [part_id for label_id in label_ids for part_id in self._part_labels.get(label_id, ())]
        return np.asarray(rows | np.isin(self.objects.part_owner, parts) if parts else rows)

    @cached_property
    def _part_labels(self) -> Mapping[int, tuple[int, ...]]:
        """Ids of the parts that bear each label."""
        if self.scene.objects is None or self.scene.objects.parts is None:
            return {}
        parts = {part.id for part in self.objects.present_parts}
        named = {label_id: tuple(i for i in ids if i in parts) for label_id, ids in self.objects.by_label.items()}
        return {label_id: ids for label_id, ids in named.items() if ids}

    def ask(
        self,
        texts: Sequence[str],
        *,
        negatives: Sequence[str] | None = None,
        templates: Sequence[str] | None = None,
        coverage: float | None = None,
    ) -> tuple[Answer, ...]:
        """Answers each text; arguments and errors as `check_query`; new templates re-embed the labels."""
        query = check_query(texts, self.settings, negatives=negatives, templates=templates, coverage=coverage)
        return RankedQuery(self.ranked, query).answer(lambda: self.objects)

    def mask3d(self, answer: Answer) -> NDArray[np.bool_]:
        """Selects Gaussians whose class or part is a relevant entry, bool [G]."""
        relevant = self._relevant_ids(answer)
        meant = self.ranked.names.picks(answer)
        return self.labeled(relevant) if meant is None else self.objects.rows(meant)

    @property
    def objects(self) -> SceneObjects:
        """All objects, named or not: stored ones, else those of `labeled_objects`."""
        from fastsplat.service.query.objects.labeled_objects import labeled_objects
        from fastsplat.service.query.objects.object_index import SceneObjects

        with self._objects_lock:
            if self._objects is None:
                scene, before = self.scene, None if self._before is None else self._before._objects
                stored = scene.objects is not None
                whole = scene.with_objects(scene.objects or labeled_objects(scene, self._labels))
                self._objects = SceneObjects(
                    whole,
                    stored,
                    lambda posed, ids: self._renderer_for(posed).id_map(posed, ids),
                    self._history,
                    before,
                )
            return self._objects

    def is_understood(self, name: str) -> bool:
        """True if the lexicon knows a name's or alias's last word; True without a lexicon."""
        label_id = self.scene.dictionary.id_of(name)
        entry = None if label_id is None else self.scene.dictionary.entries[label_id - 1]
        names = (name,) if entry is None else (entry.label, *entry.aliases)
        return self._lexicon is None or bool(label_meaning(names, self._lexicon).senses)

    def with_label(self, scene: SceneT, entry: DictionaryEntry, head: SemanticHead) -> SceneT:
        """Adds an embedded label and the head that knows it; may raise ModelUnavailableError."""
        dictionary = Dictionary((*scene.dictionary.entries, entry))
        encoder, templates = (self._encoder.name, self._encoder.sha256), scene.label_templates
        if len(scene.dictionary) and scene.text_encoder == encoder:
            rows = np.concatenate([scene.label_embeddings, embed_names([entry.label], self._encoder, templates)])
        else:
            templates = self.settings.templates
            rows = embed_labels(dictionary, self._encoder, templates)
        return replace(
            scene, dictionary=dictionary, head=head, label_embeddings=rows, text_encoder=encoder,
            label_templates=templates,
        )  # fmt: skip

    def objects_of(self, answer: Answer) -> tuple[SceneObject, ...]:
        """Visible named objects and parts of an answer with best views, by entry and size."""
        place = {label_id: number for number, label_id in enumerate(self._relevant_ids(answer))}
        if not place:
            return ()
        objects, meant = self.objects, self.ranked.names.picks(answer)
        named = [
            obj
            for obj in (*objects.listed, *objects.listed_parts)
            if obj.label_id in place and obj.box is not None and (meant is None or obj.id in meant)
        ]
        named.sort(key=lambda obj: (place[obj.label_id], -objects.extents[obj.id].opacity))
        views = objects.best_views([obj.id for obj in named])
        return tuple(replace(obj, best_views=views.get(obj.id, ())) for obj in named)

    def mask2d(self, answer: Answer, posed: PosedCamera) -> Mask2D:
        """Renders an answer's mask in one view; empty if the view shows nothing."""
        relevant = self._relevant_ids(answer)
        relevancy = np.zeros(len(self.scene.dictionary) + 1, dtype=np.float32)
        for match in answer.matches:
            if match.label_id < len(relevancy):  # what is merely suggested is no class
                relevancy[match.label_id] = match.relevancy
        classes = tuple(label_id for label_id in relevant if label_id < len(relevancy))
        drawn = self._renderer_for(posed).mask(posed, classes, relevancy)
        for label_id in relevant:
            if parts := self._part_labels.get(label_id):
                inside = np.isin(self.objects.part_map(posed), parts)
                label_ids = np.where(inside, np.uint16(label_id), drawn.label_ids)
                drawn = replace(drawn, mask=drawn.mask | inside, label_ids=label_ids)
        if (meant := self.ranked.names.picks(answer)) is not None:
            inside = self.objects.mask(posed, meant)
            drawn = replace(drawn, mask=inside, label_ids=np.where(inside, drawn.label_ids, np.uint16(0)))
        return drawn

    def mask(self, answer: Answer, posed: PosedCamera) -> NDArray[np.bool_]:
        """Computes `mask2d(answer, posed).mask`, without colors and relevancy; reuses recent object maps."""
        relevant = self._relevant_ids(answer)
        if (meant := self.ranked.names.picks(answer)) is not None:
            self.check_view(posed)
            return self.objects.mask(posed, meant)
        if self.scene.objects is not None:
            self.check_view(posed)
            ids = [object_id for label_id in relevant for object_id in self.objects.by_label.get(label_id, ())]
            return self.objects.mask(posed, ids)
        return np.asarray(np.isin(self.label_map(posed), relevant))

    def render(self, posed: PosedCamera) -> NDArray[np.uint8]:
        """Renders colors on black, uint8 [H, W, 3]."""
        return self._renderer_for(posed).colors(posed)

    @property
    def coarse(self) -> CoarseView | SceneIndex:
        """Renderer for moving cameras; for a small scene this index itself."""
        objects = self.objects
        with self._renderer_lock:
            if self._coarse is None:
                scene = coarse_scene(objects.scene)
                if scene is None:
                    return self
                self._coarse = CoarseView(scene, self.settings)
            return self._coarse

    def depth(self, posed: PosedCamera) -> NDArray[np.float32]:
        """Renders expected camera z, float32 [H, W], scene units; 0 below `alpha_min`."""
        return self._renderer_for(posed).depth(posed)

    def geometry(self, posed: PosedCamera) -> ViewGeometry:
        """Renders depth, its spread, normals, confidence and colors of one view."""
        return self._renderer_for(posed).geometry(posed)

    def label_map(self, posed: PosedCamera) -> NDArray[np.uint16]:
        """Renders each pixel's most probable class, uint16 [H, W]; 0 = undetected or barely covered."""
        return self._renderer_for(posed).label_map(posed)

    def object_map(self, posed: PosedCamera) -> NDArray[np.uint16]:
        """Renders each pixel's most probable object, uint16 [H, W]; 0 = none or barely covered."""
        self.check_view(posed)
        return self.objects.map(posed)

    def _relevant_ids(self, answer: Answer) -> tuple[int, ...]:
        entries = self.scene.dictionary.entries  # other names are suggested, and no Gaussian has them
        known = (
            (match.label_id, entries[match.label_id - 1 : match.label_id], match.label) for match in answer.matches
        )
        if any(number < 1 or (slot and slot[0].label != label) for number, slot, label in known):
            raise InvalidInputError(
                f"the answer to {answer.text[:80]!r} belongs to another scene",
                field="answer",
                hint="Ask this scene first.",
            )
        return answer.relevant_ids

    def view(self, name: str) -> PosedCamera:
        """Returns the scene's camera of this name, or raises NotFoundError."""
        for posed in self.scene.cameras:
            if posed.name == name:
                return posed
        known = ", ".join(posed.name for posed in self.scene.cameras[:_MAX_NAMED])
        raise NotFoundError(f"no view {name[:80]!r} in this scene", field="view", hint=f"Its views are: {known}.")

    def viewpoint(self, camera: PosedCamera | None, view: str | None) -> PosedCamera:
        """Returns a request's camera, or the scene's of that name; raises as `check_frame` and `view`."""
        if camera is None:
            return self.view(view or "")
        self.check_frame(camera, "camera")
        return camera

    def check_frame(self, posed: PosedCamera, field: str) -> None:
        """Raises InvalidInputError for a camera whose frame is not the scene's."""
        names = dict.fromkeys((self.scene.frame_id, WORLD))
        if posed.frame_id not in ("", *names):
            raise InvalidInputError(
                f"a camera in the frame {posed.frame_id[:80]!r}, which this version of the scene is not in",
                field=f"{field}.frame_id",
                hint=f"Transform the pose into the scene's frame, and say {' or '.join(names)}, or nothing.",
            )

    def check_view(self, posed: PosedCamera) -> None:
        """Raises LimitExceededError for a view that is too large."""
        side = _MAX_IMAGE_SIDE
        if max(posed.camera.width, posed.camera.height) > side:
            raise LimitExceededError(
                f"an image of {posed.camera.width}×{posed.camera.height} pixels",
                field="camera.width/height",
                limit=f"{side} pixels a side",
                hint="Ask for a smaller image and scale the intrinsics with it.",
            )

    def _renderer_for(self, posed: PosedCamera) -> Renderer:
        self.check_view(posed)
        with self._renderer_lock:
            if self._renderer is None:
                from fastsplat.service.query.drawing.scene_renderer import Renderer

                self._renderer = Renderer(self.scene, self.settings)
            return self._renderer
