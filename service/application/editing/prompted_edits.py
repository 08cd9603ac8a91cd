"""Prompts of `split` and `add`: validated, segmented in renderings, lifted to Gaussians."""

from __future__ import annotations

import weakref
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from fastsplat.service.application.answering.project_context import ProjectContext
from fastsplat.service.application.base.cache import BudgetedCache
from fastsplat.service.application.base.memory import masks_bytes
from fastsplat.service.application.base.validate import check_viewpoint
from fastsplat.service.common.cache import LeastRecentlyUsed
from fastsplat.service.query.scene_index import SceneIndex
from fastsplat.service.scene.artefact.scene import Gaussians
from fastsplat_contract.errors import InvalidInputError, LimitExceededError, NotFoundError
from fastsplat_contract.geometry.camera import Camera, PosedCamera
from fastsplat_contract.geometry.object_prompts import PROMPTED, ObjectPrompt, Pixel, PixelBox
from fastsplat_contract.messages.scenes import Edit

if TYPE_CHECKING:  # onnxruntime loads with the first prompt
    from fastsplat.service.instances.prompt_answers import PicturePrompt
    from fastsplat.service.perception.results import Segmenter


_MAX_PROMPT_PIXELS = 64
"""Limit of foreground and background pixels in a prompt."""

_KEPT_VIEWS = 16
"""Cached view embeddings (LRU), about 4 MiB each."""

_SEGMENTER_BYTES = (768 << 20) + _KEPT_VIEWS * (4 << 20)
"""MobileSAM after its first pictures (690 MiB measured, mostly activations), and 256×64×64 float32 a picture."""

_Key = tuple[int, Camera, bytes]


@dataclass(frozen=True)
class ShownPiece:
    """Gaussians selected by a prompt, int64 [K], and the supporting views ("": free viewpoint)."""

    rows: NDArray[np.int64]
    views: tuple[str, ...]


class PromptedEdits:
    """Segmentation of prompted edits. Thread-safe.

    Renderings are used even if photos are kept: photos do not show edits, and not every view has one. Where both could
    be used, they led to the same pieces.
    """

    def __init__(self, context: ProjectContext) -> None:
        self._context, self._settings = context, context.settings
        self._segmenters: BudgetedCache[str, _OpenSegmenter] = BudgetedCache(_SEGMENTER_BYTES, context.memory)

    def check(self, edits: Sequence[Edit]) -> None:
        """Validates all prompts; errors name the field inside `edits`."""
        for number, edit in enumerate(edits):
            if edit.prompt is not None and edit.action in PROMPTED:
                try:
                    _check(edit.prompt)
                except (InvalidInputError, LimitExceededError) as error:
                    raise error.within(f"edits[{number}].prompt") from error

    def bytes(self, edits: Sequence[Edit], gaussians: int) -> int:
        """Estimated peak of segmentation, beside the open scene and the edits."""
        if not any(edit.action in PROMPTED for edit in edits):
            return 0
        side = self._settings.prompts.max_side
        return _SEGMENTER_BYTES + masks_bytes([_square(side)], 1, gaussians)

    @contextmanager
    def running(self) -> Iterator[None]:
        """Context for reserving `bytes` and making these edits; the segmenter stays open if there is room."""
        try:
            yield
        finally:
            self._segmenters.count()

    def piece(self, index: SceneIndex, edit: Edit) -> ShownPiece | None:
        """Segments the Gaussians of a `split` or `add` prompt; None without a prompt.

        Raises:
            NotFoundError: no such view; for split, no such object or label.
            InvalidInputError: another frame; a pixel outside the picture or, for split, off the object; a box outside
                or
                without area.
            ModelUnavailableError: the segmenter is missing.
        """
        if edit.prompt is None or edit.action not in PROMPTED:
            return None
        from fastsplat.service.instances.prompted_pieces import PromptedScene, find_piece
        from fastsplat.service.query.edits.prompted_objects import split_object
        from fastsplat.service.query.objects.visibility import further_views

        object_id = split_object(index, edit) if edit.action == "split" else 0
        try:
            posed = index.viewpoint(edit.prompt.camera, edit.prompt.view)
            prompt = _in_picture(edit.prompt, posed)
            small = posed.limited_to(self._settings.prompts.max_side)
            prompt = prompt.scaled(small.camera.width / posed.camera.width, small.camera.height / posed.camera.height)
            ids = index.objects.map(small)
            _check_on_object(prompt, ids, object_id)
        except (NotFoundError, InvalidInputError) as error:
            raise error.within("prompt") from error
        opened = self._opened()
        gaussians = index.scene.gaussians
        more = self._settings.prompts.views - 1
        scene = PromptedScene(
            gaussians,
            index.objects.owner == object_id if object_id else None,
            opened.segmenter,
            lambda view: opened.embedding(gaussians, view, lambda: index.render(view)),
            lambda rows: [
                view.limited_to(self._settings.prompts.max_side)
                for view in further_views(index.scene, rows, posed, more)
            ],
            index.settings.backend,
        )
        piece = find_piece(scene, small, prompt, ids)
        return ShownPiece(piece.rows, tuple(view.name for view in piece.views))

    def _opened(self) -> _OpenSegmenter:
        """The segmenter, opened if necessary; raises `ModelUnavailableError` for missing or damaged files."""
        from fastsplat.service.perception.segmenters.open_segmenter import open_segmenter

        settings = self._context.settings_in_use
        perception = settings.perception
        return self._segmenters.get(
            perception.segmenter,
            lambda: _SEGMENTER_BYTES,
            lambda: _OpenSegmenter(open_segmenter(perception, settings.models)),
        )


def _check(prompt: ObjectPrompt) -> None:
    check_viewpoint("prompt", prompt.camera, prompt.view)
    if not prompt.pixels and prompt.box is None:
        raise InvalidInputError(
            "a prompt without a pixel on the object or a box around it",
            field="pixels",
            hint="Send at least one of the two.",
        )
    count = len(prompt.pixels) + len(prompt.background)
    if count > _MAX_PROMPT_PIXELS:
        raise LimitExceededError(
            f"{count} pixels in one prompt",
            field="pixels" if len(prompt.pixels) >= len(prompt.background) else "background",
            limit=f"{_MAX_PROMPT_PIXELS} pixels, background included",
            hint="A few pixels say as much.",
        )


def _in_picture(prompt: ObjectPrompt, posed: PosedCamera) -> PicturePrompt:
    from fastsplat.service.instances.prompt_answers import PicturePrompt
    from fastsplat.service.query.objects.picking import check_box, check_pixel

    for name, pixels in (("pixels", prompt.pixels), ("background", prompt.background)):
        for number, pixel in enumerate(pixels):
            check_pixel(posed, pixel, f"{name}[{number}]")
    box = prompt.box
    if box is not None:
        check_box(posed, box)
    return PicturePrompt(_array(prompt.pixels), _array(prompt.background), None if box is None else _corners(box))


def _check_on_object(prompt: PicturePrompt, ids: NDArray[np.uint16], object_id: int) -> None:
    """Rejects pixels off the object that is split."""
    from fastsplat.service.instances.prompt_answers import values_at

    for number, pixel_id in enumerate(values_at(ids, prompt.pixels).tolist() if object_id else ()):
        if pixel_id != object_id:
            raise InvalidInputError(
                f"the pixel shows {f'object {pixel_id}' if pixel_id else 'no object'}, not object {object_id}",
                field=f"pixels[{number}]",
                hint="Pick the pixel first: it says which object is there.",
            )


def _array(pixels: Sequence[Pixel]) -> NDArray[np.float64]:
    return np.array(pixels, np.float64).reshape(-1, 2)


def _corners(box: PixelBox) -> NDArray[np.float64]:
    return np.array([box.left, box.top, box.right, box.bottom], np.float64)


def _square(side: int) -> PosedCamera:
    return PosedCamera(Camera(side, side, float(side), float(side), side / 2, side / 2), np.eye(4))


class _OpenSegmenter:
    """Segmenter with its latest view embeddings. Thread-safe."""

    def __init__(self, segmenter: Segmenter) -> None:
        self.segmenter = segmenter
        self._embeddings: LeastRecentlyUsed[_Key, tuple[weakref.ref[Gaussians], Any]] = LeastRecentlyUsed(_KEPT_VIEWS)

    def embedding(self, gaussians: Gaussians, posed: PosedCamera, picture: Callable[[], NDArray[np.uint8]]) -> Any:
        """Segmenter embedding of these Gaussians, rendered from a camera."""
        key = (id(gaussians), posed.camera, posed.world_from_camera.tobytes())

        def embed() -> tuple[weakref.ref[Gaussians], Any]:
            return weakref.ref(gaussians), self.segmenter.embed(picture())

        whose, embedding = self._embeddings.get(key, lambda: 1, embed)
        if whose() is not gaussians:  # of others, which had the same id
            self._embeddings.drop(lambda known: known == key)
            _, embedding = self._embeddings.get(key, lambda: 1, embed)
        return embedding
