"""Memory-bounded cache of open scene versions, memory-mapped on first use."""

from __future__ import annotations

import copy
import threading
from pathlib import Path
from typing import TYPE_CHECKING

from fastsplat.service.application.base.memory import MemoryBudget
from fastsplat.service.common.cache import LeastRecentlyUsed
from fastsplat.service.common.setting_groups import ModelChoice
from fastsplat.service.jobs.needed_models import in_use
from fastsplat.service.query.language.meaning.embeddings import TextCaches, text_caches
from fastsplat.service.query.objects.object_index import KEPT_MAP_BYTES
from fastsplat.service.query.ranked_scene import RankedScene
from fastsplat.service.query.scene_index import SceneIndex
from fastsplat.service.scene.artefact.scene import Scene
from fastsplat.service.scene.artefact.scene_files import read_scene
from fastsplat.service.settings import Settings
from fastsplat.service.store.store import Store
from fastsplat_contract.errors import InvalidInputError, NotFoundError, NotReadyError, SceneFileError
from fastsplat_contract.geometry.poses import F64
from fastsplat_contract.messages.queries import QueryIn
from fastsplat_contract.messages.scenes import SceneState

if TYPE_CHECKING:  # onnxruntime loads with the first question, not with the server
    from fastsplat.service.perception.lexicon.wordnet import Lexicon
    from fastsplat.service.perception.results import TextEncoder
    from fastsplat.service.query.phrases.object_looks import LooksModel

_TRIES = 3
_COPIES = 2
"""Mapped pages, and the renderer's activated arrays; open scenes also keep maps."""


class OpenScenes:
    """Cache of open scenes, text encoders, embeddings and the lexicon. Thread-safe."""

    def __init__(self, store: Store, settings: Settings, memory: MemoryBudget) -> None:
        self._store = store
        self._settings = settings
        self._memory = memory
        self._open: LeastRecentlyUsed[tuple[str, str], SceneIndex] = LeastRecentlyUsed(
            settings.calls.scene_memory_bytes
        )
        self._ranked: LeastRecentlyUsed[tuple[str, str], RankedScene] = LeastRecentlyUsed(
            settings.calls.ranking_memory_bytes
        )
        self._encoders: dict[str, TextEncoder] = {}
        self._lexicons: dict[str, Lexicon] = {}
        self._looks_models: dict[str, LooksModel] = {}
        self._caches: dict[str, TextCaches] = {}
        self._encoder_lock = threading.Lock()
        self._first = self  # of all views of the store; it has the choice of models
        self._choice: ModelChoice = {}

    def over(self, store: Store) -> OpenScenes:
        """Same memory, encoders and lexicon for another view of the store."""
        clone = copy.copy(self)
        clone._store = store
        return clone

    def count(self) -> int:
        """Number of open scenes."""
        return len(self._open)

    def close(self) -> None:
        """Drops every open scene."""
        self._open.drop(lambda key: True)
        self._ranked.drop(lambda key: True)

    def forget(self, scene_id: str) -> None:
        """Drops one scene."""
        self._open.drop(lambda key: key[0] == scene_id)
        self._ranked.drop(lambda key: key[0] == scene_id)

    def open(self, scene_id: str, version: str) -> tuple[SceneIndex, str]:
        """Index of a version ("": the current one), and its name.

        Raises:
            NotFoundError: no such scene or version.
            NotReadyError: nothing of it can be queried yet, or its job ended before.
            SceneFileError: its files are damaged or missing.
            LimitExceededError, CancelledError, DeadlineExceededError, CallAgainError: as `MemoryBudget.opening`.
        """
        name = self.version(scene_id, version)
        folder = self.folder(scene_id, name)
        return self._open.get((scene_id, name), lambda: _weigh_open(folder), lambda: self._load(scene_id, name)), name

    def ranked(self, scene_id: str) -> tuple[str, RankedScene]:
        """Current version and its answers without Gaussians; raises as `open`.

        These answers have a memory budget of their own: the version opens with the first query, and may be evicted
        earlier.
        """
        name = self.version(scene_id, "")
        scenes: list[RankedScene] = []

        def weigh() -> int:
            scenes.append(self.open(scene_id, name)[0].ranked)
            return scenes[0].nbytes

        return name, self._ranked.get((scene_id, name), weigh, lambda: scenes[0])

    def keep(self, scene_id: str, version: str, index: SceneIndex) -> None:
        """Caches a version that was just written, so that it is not read back."""
        folder = self.folder(scene_id, version)
        self._open.get((scene_id, version), lambda: _weigh_open(folder), lambda: index)

    def version(self, scene_id: str, version: str) -> str:
        """Name of a readable version ("": the current one); raises as `open`."""
        self._renew()
        state, current, operation_id = self._store.scenes.current_version(scene_id)
        if not current:
            raise _not_ready(scene_id, state, operation_id)
        if version and version != current and not self._store.versions.known(scene_id, version):
            raise NotFoundError(
                f"scene {scene_id!r} has no version {version[:80]!r}",
                field="version",
                hint="List its versions, or leave the version out for the current one.",
            )
        return version or current

    def finished(self, scene_id: str) -> str:
        """Current version of a READY scene; raises `NotReadyError` or `NotFoundError`."""
        state, current, operation_id = self._store.scenes.current_version(scene_id)
        if state != "READY":
            raise _not_ready(scene_id, state, operation_id)
        return current

    def folder(self, scene_id: str, version: str) -> Path:
        """Folder of a version; raises `NotFoundError` if the scene was deleted."""
        folder = self._store.blobs.fetch_version(scene_id, version)
        if folder is None:
            raise _deleted(scene_id)
        return folder

    @property
    def _settings_in_use(self) -> Settings:
        return in_use(self._settings, self._first._choice)

    def _renew(self) -> None:
        """Drops what was opened with other models than those chosen now."""
        choice = self._store.models.chosen()
        with self._encoder_lock:
            if choice == self._first._choice:
                return
            self._first._choice = choice
            for opened in (self._encoders, self._lexicons, self._looks_models, self._caches):
                opened.clear()
        self.close()

    def _load(self, scene_id: str, version: str) -> SceneIndex:
        for _ in range(_TRIES):  # the local copy may be evicted before it is opened
            folder = self.folder(scene_id, version)
            with self._memory.opening(_weigh(folder)):
                try:
                    scene = read_scene(folder / "artefact")
                except NotFoundError:
                    continue
                return self.index_of(scene)
        if self.folder(scene_id, version).is_dir():
            raise SceneFileError(
                f"version {version} of scene {scene_id} has no folder artefact",
                field="scene",
                hint="Restore the scene's folder from a backup, or train it again.",
            )
        raise _deleted(scene_id)

    def index_of(self, scene: Scene) -> SceneIndex:
        """Index of a scene that is not stored or cached."""
        encoder = self._encoder(scene.text_encoder[0])
        with self._encoder_lock:
            if encoder.name not in self._caches:
                self._caches[encoder.name] = text_caches(encoder, self._settings.query)
            caches = self._caches[encoder.name].of(self._store.project)
        return SceneIndex(
            scene, encoder, self._settings.query, lexicon=self._lexicon(), caches=caches, looks=self._looks()
        )

    def _encoder(self, name: str) -> TextEncoder:
        from fastsplat.service.perception.text.text_encoders import open_text_encoder

        with self._encoder_lock:
            if name not in self._encoders:
                self._encoders[name] = open_text_encoder(name, self._settings.models)
            return self._encoders[name]

    def _lexicon(self) -> Lexicon | None:
        from fastsplat.service.perception.lexicon.wordnet import find_lexicon

        name = self._settings_in_use.perception.lexicon
        with self._encoder_lock:
            if name not in self._lexicons and (opened := find_lexicon(name, self._settings.models)) is not None:
                self._lexicons[name] = opened
            return self._lexicons.get(name)

    def _looks(self) -> LooksModel | None:
        perception = self._settings_in_use.perception
        if not (name := perception.image_text):
            return None
        from fastsplat.service.query.phrases.looks_files import find_looks

        with self._encoder_lock:
            opened = self._looks_models.get(name) or find_looks(perception, self._settings.models)
            if opened is not None:
                self._looks_models[name] = opened
            return opened


def asker_of(index: SceneIndex, request: QueryIn) -> F64 | None:
    """Asker's pose, float64 [4, 4], world from camera, OpenCV axes; None if absent.

    Raises:
        InvalidInputError: asker and asker_view are both set.
        NotFoundError: no such view.
    """
    if request.asker is not None and request.asker_view is not None:
        raise InvalidInputError("asker and asker_view at once", field="asker_view", hint="Send one of them.")
    if request.asker_view is None:
        return None if request.asker is None else request.asker.matrix()
    try:
        return index.view(request.asker_view).world_from_camera
    except NotFoundError as error:
        raise NotFoundError(error.message, field="asker_view", hint=error.hint) from error


def _weigh(folder: Path) -> int:
    try:
        return _COPIES * sum(path.stat().st_size for path in (folder / "artefact").glob("*") if path.is_file())
    except FileNotFoundError:  # being removed; reading will raise
        return 0


def _weigh_open(folder: Path) -> int:
    return _weigh(folder) + KEPT_MAP_BYTES


def _not_ready(scene_id: str, state: SceneState, operation_id: str) -> NotReadyError:
    problem, hint = {
        "TRAINING": (f"scene {scene_id!r} is still being made", "Wait for"),
        "FAILED": (f"the job of scene {scene_id!r} failed", "Look at the error of, or retry,"),
        "CANCELLED": (f"the job of scene {scene_id!r} was cancelled", "Retry"),
    }[state]
    return NotReadyError(problem, field="scene", hint=f"{hint} operation {operation_id}.")


def _deleted(scene_id: str) -> NotFoundError:
    return NotFoundError(f"scene {scene_id!r} was deleted meanwhile", field="scene")
