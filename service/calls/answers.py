"""Questions to finished scenes: which artefact, kept open how long, asked what."""

from __future__ import annotations

import tempfile
import threading
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Literal, TypeVar

import numpy as np

from service.calls.cache import LeastRecentlyUsed
from service.calls.types import QueryAnswer, QueryRequest, RleMask, ViewMask
from service.common.camera import PosedCamera
from service.common.errors import (
    InvalidInputError,
    LimitExceededError,
    NotFoundError,
    NotReadyError,
)
from service.query import Answer, SceneIndex, pictures
from service.query.names import check_texts
from service.query.rle import encode_rle, pack_bits
from service.scene import read_scene, write_ply
from service.settings import Settings
from service.store import Store

if TYPE_CHECKING:  # onnxruntime loads with the first question, not with the server
    from service.perception.text import TextEncoder

T = TypeVar("T")
_MAX_NAMED = 20


class Answers:
    """Open scenes and the text encoder, shared by all threads."""

    def __init__(self, store: Store, settings: Settings) -> None:
        self._store = store
        self._settings = settings
        self._open: LeastRecentlyUsed[tuple[str, str], SceneIndex] = LeastRecentlyUsed(settings.store.cached_scenes)
        self._encoders: dict[str, TextEncoder] = {}
        self._encoder_lock = threading.Lock()

    def close(self) -> None:
        """Let go of every open scene."""
        self._open.drop(lambda key: True)

    def forget(self, scene_id: str) -> None:
        """Let go of one scene."""
        self._open.drop(lambda key: key[0] == scene_id)

    def query(self, request: QueryRequest) -> tuple[QueryAnswer, ...]:
        """See `SceneService.query`."""
        self._check_texts(request.texts)
        if "mask2d" in request.outputs and not (request.cameras or request.views):
            raise InvalidInputError(
                '"mask2d" needs a camera or a view', field="cameras", hint="Send a pose, or the name of a view."
            )
        self._check_cameras(len(request.cameras) + len(request.views))
        return self._reading(request.scene_id, lambda index: self._answer(index, request))

    def query_all(self, texts: tuple[str, ...], outputs: frozenset[str]) -> tuple[QueryAnswer, ...]:
        """See `SceneService.query_all`."""
        if "mask2d" in outputs:
            raise InvalidInputError(
                '"mask2d" needs one scene: cameras belong to a scene', field="outputs", hint="Name the scene."
            )
        self._check_texts(texts)
        wanted: frozenset[Literal["mask2d", "mask3d"]] = frozenset({"mask3d"} if "mask3d" in outputs else ())
        answers: list[QueryAnswer] = []
        for scene_id in self._store.rows.ready_scene_ids():
            try:
                answers.extend(self.query(QueryRequest(scene_id, texts, outputs=wanted)))
            except NotFoundError:
                continue  # deleted since it was listed
        return tuple(answers)

    def picture(
        self, scene_id: str, text: str | None, kind: str, camera: PosedCamera | None, view: str | None
    ) -> bytes:
        """See `SceneService.view_picture`."""
        if (camera is None) == (view is None):
            raise InvalidInputError(
                "a picture needs exactly one of camera and view", field="view", hint="Name a view or send a pose."
            )
        if kind not in ("rgb", "overlay", "relevancy", "mask"):
            raise InvalidInputError(
                f"no picture of kind {kind[:40]!r}", field="kind", hint='Use "rgb", "overlay", "relevancy" or "mask".'
            )
        if kind != "rgb":
            if text is None:
                raise InvalidInputError(f'a picture of kind "{kind}" needs a text', field="text")
            self._check_texts((text,))
        return self._reading(scene_id, lambda index: _picture(index, text, kind, camera or _view(index, view or "")))

    def scene_ply(self, scene_id: str) -> Path:
        """See `SceneService.scene_ply`."""
        path = self._folder(scene_id, self._ready_version(scene_id)) / "scene.ply"
        if not path.is_file():
            raise NotFoundError(f"scene {scene_id!r} was deleted meanwhile", field="scene")
        return path

    def mask_ply(self, scene_id: str, text: str) -> bytes:
        """See `SceneService.mask_ply`."""
        self._check_texts((text,))

        def read(index: SceneIndex) -> bytes:
            (answer,) = index.ask((text,))
            with tempfile.TemporaryDirectory(prefix="fastsplat-") as folder:
                path = Path(folder) / "mask.ply"
                write_ply(index.scene.gaussians, path, rows=index.mask3d(answer))
                return path.read_bytes()

        return self._reading(scene_id, read)

    def _answer(self, index: SceneIndex, request: QueryRequest) -> tuple[QueryAnswer, ...]:
        cameras = [("", number, posed) for number, posed in enumerate(request.cameras)]
        cameras += [(name, 0, _view(index, name)) for name in request.views]
        answers: list[QueryAnswer] = []
        for answer in index.ask(request.texts):
            masks = [_mask2d(index, answer, *camera) for camera in cameras] if "mask2d" in request.outputs else []
            packed = pack_bits(index.mask3d(answer)) if "mask3d" in request.outputs else b""
            answers.append(QueryAnswer(request.scene_id, answer, tuple(masks), packed))
        return tuple(answers)

    def _reading(self, scene_id: str, use: Callable[[SceneIndex], T]) -> T:
        version = self._ready_version(scene_id)
        index = self._open.get((scene_id, version), lambda: self._load(scene_id, version))
        return use(index)

    def _ready_version(self, scene_id: str) -> str:
        state, version, operation_id = self._store.rows.version(scene_id)
        if state != "READY":
            training = state == "TRAINING"
            raise NotReadyError(
                f"scene {scene_id!r} is still being made" if training else f"the job of scene {scene_id!r} failed",
                field="scene",
                hint=f"{'Wait for' if training else 'Look at the error of'} operation {operation_id}.",
            )
        return version

    def _load(self, scene_id: str, version: str) -> SceneIndex:
        folder = self._folder(scene_id, version) / "artefact"
        if not folder.is_dir():
            raise NotFoundError(f"scene {scene_id!r} was deleted meanwhile", field="scene")
        scene = read_scene(folder)
        return SceneIndex(scene, self._encoder(scene.text_encoder[0]), self._settings.query)

    def _encoder(self, name: str) -> TextEncoder:
        from service.perception.text import open_text_encoder

        with self._encoder_lock:
            if name not in self._encoders:
                self._encoders[name] = open_text_encoder(name, self._settings.models)
            return self._encoders[name]

    def _folder(self, scene_id: str, version: str) -> Path:
        return self._store.blobs.version(scene_id, version)

    def _check_texts(self, texts: tuple[str, ...]) -> None:
        limits = self._settings.query
        check_texts(texts, max_texts=limits.max_texts, max_chars=limits.max_text_chars)

    def _check_cameras(self, count: int) -> None:
        limit = self._settings.query.max_poses
        if count > limit:
            raise LimitExceededError(
                f"{count} cameras",
                field="cameras",
                limit=f"{limit} cameras (FASTSPLAT_QUERY__MAX_POSES)",
                hint="Ask in several requests.",
            )


def _view(index: SceneIndex, name: str) -> PosedCamera:
    for posed in index.scene.cameras:
        if posed.name == name:
            return posed
    known = ", ".join(posed.name for posed in index.scene.cameras[:_MAX_NAMED])
    raise NotFoundError(f"no view {name[:80]!r} in this scene", field="view", hint=f"Its views are: {known}.")


def _mask2d(index: SceneIndex, answer: Answer, name: str, number: int, posed: PosedCamera) -> ViewMask:
    mask = index.mask2d(answer, posed).mask
    return ViewMask(name, number, RleMask(mask.shape[0], mask.shape[1], encode_rle(mask)), int(mask.sum()))


def _picture(index: SceneIndex, text: str | None, kind: str, posed: PosedCamera) -> bytes:
    if kind == "rgb" or text is None:
        return pictures.png_bytes(index.render(posed))
    (answer,) = index.ask((text,))
    seen = index.mask2d(answer, posed)
    if kind == "mask":
        return pictures.png_bytes(seen.mask.astype(np.uint8) * 255)
    if kind == "relevancy":
        return pictures.png_bytes(pictures.relevancy_picture(seen.rgb, seen.relevancy))
    names = [(match.label_id, match.label) for match in answer.matches if match.relevant]
    return pictures.png_bytes(pictures.named_overlay(seen.rgb, seen.label_ids, names))
