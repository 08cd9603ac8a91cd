"""Queries one scene in a folder within this process, using the service's types.

The folder is a service's data folder: `fastsplat view` shows it in the browser, `fastsplat serve` with
FASTSPLAT_DATA_DIR serves it. Several processes may open it.
"""

from __future__ import annotations

import html
import io
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from fastsplat.service.application.service import SceneService, open_service
from fastsplat.service.settings import Settings, find_models, load_settings
from fastsplat.service.store.rows.database import SQLITE_NAME
from fastsplat_contract.errors import NotFoundError, NotReadyError
from fastsplat_contract.geometry.camera import PosedCamera
from fastsplat_contract.geometry.places import Place
from fastsplat_contract.masks import decode_mask3d
from fastsplat_contract.messages.exports import ExportRequest
from fastsplat_contract.messages.measurements import Measurement, MeasureRequest
from fastsplat_contract.messages.objects import SceneObject
from fastsplat_contract.messages.queries import Answer, Output, QueryRequest
from fastsplat_contract.messages.scenes import Edit, Scene, SceneSummary, SceneVersion
from fastsplat_contract.photos.pictures import PictureKind, PictureRequest

Viewpoint = str | PosedCamera
"""Name of one of the scene's cameras, or a free viewpoint."""


@dataclass(frozen=True)
class Picture:
    """A picture with a caption, displayed by notebooks.

    Examples:
        >>> Image.new("RGB", (4, 2)).save(file := io.BytesIO(), "PNG")
        >>> picture = Picture(file.getvalue(), "nothing yet")
        >>> picture, picture.array().shape
        (Picture('nothing yet'), (2, 4, 3))
    """

    png: bytes  # a PNG file
    sentence: str  # the caption

    def array(self) -> NDArray[np.uint8]:
        """Decodes the picture to RGB, uint8 [H, W, 3]."""
        with Image.open(io.BytesIO(self.png)) as image:
            return np.asarray(image.convert("RGB"))

    def save(self, path: str | Path) -> None:
        Path(path).write_bytes(self.png)

    def _repr_png_(self) -> bytes:
        return self.png

    def __repr__(self) -> str:
        return f"Picture({self.sentence!r})"


class LocalScene(AbstractContextManager["LocalScene"]):
    """A trained scene in a folder; a thread-safe context manager.

    Methods raise the service's `FastSplatError`s, see `fastsplat_contract.errors`.

    Examples:
        >>> from fastsplat import open_sample
        >>> with open_sample() as scene:
        ...     scene.ask("cup").sentence
        ...     scene.mask3d("cup").shape, scene.image("images/000.jpg").shape
        'Here: "cup".'
        ((13827,), (360, 480, 3))
    """

    def __init__(self, service: SceneService, scene_id: str) -> None:
        self._service = service
        self.id = scene_id
        self._closing: list[Callable[[], object]] = []

    def __exit__(self, *exception: object) -> None:
        self.close()

    def close(self) -> None:
        """Releases the folder; that of `open_sample` is deleted."""
        self._service.close()
        while self._closing:
            self._closing.pop()()

    def on_close(self, action: Callable[[], object]) -> None:
        """Calls `action` once, when the scene is closed."""
        self._closing.append(action)

    @property
    def info(self) -> Scene:
        """Current cameras, dictionary, quality, scale and vertical."""
        return self._service.get_scene(self.id)

    @property
    def views(self) -> tuple[str, ...]:
        """Names of the scene's cameras."""
        return tuple(posed.name for posed in self.info.cameras)

    def ask(self, text: str, *, viewpoints: Sequence[Viewpoint] = (), **choices: Any) -> Answer:
        """Finds the objects that match a text, and their masks in the viewpoints.

        Args:
            text: in plain words.
            viewpoints: views to mask; free ones come first in the answer.
            choices: version, negatives, templates, coverage, max_matches, as in `QueryRequest`.
        """
        cameras = tuple(camera for camera in viewpoints if not isinstance(camera, str))
        views = tuple(view for view in viewpoints if isinstance(view, str))
        outputs: frozenset[Output] = frozenset({"objects", "mask2d"} if viewpoints else {"objects"})
        (answer,) = self._service.answers.query(
            QueryRequest(self.id, (text,), cameras, views, outputs, **choices)
        ).answers
        return answer

    def mask(self, text: str, viewpoint: Viewpoint) -> NDArray[np.bool_]:
        """Masks the pixels of a view that match a text, bool [H, W]."""
        return self.ask(text, viewpoints=(viewpoint,)).masks[0].array()

    def mask3d(self, text: str) -> NDArray[np.bool_]:
        """Masks the current version's Gaussians that match a text, bool [G]."""
        (answer,) = self._service.answers.query(QueryRequest(self.id, (text,), outputs=frozenset({"mask3d"}))).answers
        return decode_mask3d(answer.mask3d or b"", "bits", answer.gaussians)

    def objects(self) -> tuple[SceneObject, ...]:
        """Lists all objects, named or not, by id."""
        objects: list[SceneObject] = []
        token = ""
        while True:
            page = self._service.answers.list_objects(self.id, page_token=token)
            objects.extend(page.objects)
            if not (token := page.next_page_token):
                return tuple(objects)

    def measure(self, *places: Place | int) -> Measurement:
        """Measures a position, an object's size (by id), or the distance of two places."""
        located = tuple(Place(object_id=place) if isinstance(place, int) else place for place in places)
        return self._service.answers.measure(MeasureRequest(self.id, located))

    def name(
        self, object_id: int, name: str, *, aliases: Sequence[str] = (), kinds: Sequence[str] = ()
    ) -> SceneVersion:
        """Names an object in a new version; see `Edit` for aliases and kinds."""
        edit = Edit("name", object_ids=(object_id,), name=name, aliases=tuple(aliases), kinds=tuple(kinds))
        return self._service.versions.edit(self.id, [edit])

    def image(self, viewpoint: Viewpoint) -> NDArray[np.uint8]:
        """Renders the scene from a viewpoint, RGB uint8 [H, W, 3]."""
        return Picture(self._png("rgb", viewpoint), "").array()

    def show(self, text: str = "", viewpoint: Viewpoint = "") -> Picture:
        """Renders all objects, or the matches of `text` from the best camera unless given."""
        cameras = self.info.cameras
        if not text:
            chosen = viewpoint or cameras[len(cameras) // 2].name
            return Picture(self._png("objects", chosen), f"{self.info.name}: every object in a color of its own")
        answer = self.ask(text)
        if not viewpoint and answer.outcome in ("here", "probably_here"):
            best = self._service.photos.best_views(self.id, (), text, 1).views
            viewpoint = best[0].view if best else ""
        chosen = viewpoint or cameras[len(cameras) // 2].name
        return Picture(self._png("overlay", chosen, text), answer.sentence)

    def viewer(self, height: int = 560) -> Viewer:
        """Returns an interactive 3D viewer for a notebook cell of `height` CSS pixels.

        Raises:
            NotFoundError: the web page is not built in this installation; `show` works without.
        """
        return Viewer(self._service.exports.file(ExportRequest(self.id, "html")), height)

    def _png(self, kind: PictureKind, viewpoint: Viewpoint, text: str = "") -> bytes:
        of = {"view": viewpoint} if isinstance(viewpoint, str) else {"camera": viewpoint}
        return self._service.answers.picture(PictureRequest(kind=kind, text=text or None, scene_id=self.id, **of))

    def __repr__(self) -> str:
        info = self.info
        return f"LocalScene({info.name!r}: {info.gaussians} Gaussians, {info.label_count} labels)"


def open_scene(folder: str | Path) -> LocalScene:
    """Opens the trained scene in a folder.

    Examples:
        >>> from fastsplat.service.library.sample import sample_folder
        >>> with sample_folder() as folder, open_scene(folder) as scene:
        ...     scene
        LocalScene('sample': 13827 Gaussians, 16 labels)

    Raises:
        NotFoundError: the folder has no scene.
        NotReadyError: training has not finished, or has failed.
    """
    place = Path(folder)
    if not (place / SQLITE_NAME).is_file():
        raise NotFoundError(f"there is no scene in {place}", field="folder", hint="Train one: fastsplat train PHOTOS.")
    service = open_service(folder_settings(place))
    try:
        scene = newest_scene(service)
        if scene is None or scene.state != "READY":
            raise NotReadyError(f"the scene in {place} has not been trained to its end", field="folder")
        return LocalScene(service, scene.id)
    except BaseException:
        service.close()
        raise


def newest_scene(service: SceneService) -> SceneSummary | None:
    """Returns the folder's newest scene, or None."""
    return next(iter(service.list_scenes(page_size=1).scenes), None)


def folder_settings(folder: Path) -> Settings:
    """Loads the environment's settings, with all storage in `folder` instead of a server."""
    settings = load_settings()
    models = settings.models if "models" in settings.model_fields_set else find_models(folder)
    return settings.model_copy(
        update={
            "models": models,
            "data_dir": folder.resolve(),
            "database_url": "",
            "artefacts": type(settings.artefacts).model_construct(),
        }
    )


@dataclass(frozen=True)
class Viewer:
    """An interactive 3D scene that notebooks display: orbit, move, zoom, find its names.

    Examples:
        >>> Viewer(b"<p>A page</p>")
        Viewer(13 bytes of HTML)
    """

    page: bytes  # self-contained HTML of `ExportRequest(..., "html")`; needs WebGL 2
    height: int = 560  # of the cell, CSS pixels

    def save(self, path: str | Path) -> None:
        """Writes the HTML file, which opens from disk."""
        Path(path).write_bytes(self.page)

    def _repr_html_(self) -> str:
        # The sandbox gives it its own origin, so it cannot reach the notebook; the search box needs forms.
        page = html.escape(self.page.decode(), quote=True)
        return (
            f'<iframe srcdoc="{page}" sandbox="allow-scripts allow-forms" title="the scene in 3D" width="100%" '
            f'height="{self.height}" style="border: 0"></iframe>'
        )

    def __repr__(self) -> str:
        return f"Viewer({len(self.page)} bytes of HTML)"
