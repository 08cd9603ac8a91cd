"""The calls about photos of scenes, photos that find their place in one, and cameras that show a thing best."""

from __future__ import annotations

import json
import uuid
from collections.abc import Iterator, Sequence
from datetime import datetime
from pathlib import Path

from fastsplat_client.errors import read
from fastsplat_client.table_calls import TableCalls, scene_path
from fastsplat_contract import calls
from fastsplat_contract.codec.json_codec import to_plain
from fastsplat_contract.geometry.poses import Pose
from fastsplat_contract.messages import requests
from fastsplat_contract.photos.localization import Localization
from fastsplat_contract.photos.next_photos import NextPhoto
from fastsplat_contract.photos.observations import GetObservationRequest, ListObservationsRequest, Observation
from fastsplat_contract.photos.scene_photos import BestView, ScenePhoto


class PhotoCalls(TableCalls):
    """The part of `Client` that speaks of photos."""

    def photos(self, scene_id: str, *, version: str = "") -> Iterator[ScenePhoto]:
        """The photos that are stored with a scene, in the order of its cameras, page by page."""
        pages = self._pages(calls.LIST_PHOTOS, requests.ListPhotosRequest(scene_id, version))
        return (photo for page in pages for photo in page.photos)

    def photo(self, scene_id: str, view: str, *, version: str = "") -> bytes:
        """The photo of one of the scene's cameras (its name) as a JPEG file.

        It is undistorted, so that it fits the camera with the intrinsics scaled to its size
        (`PosedCamera.camera.scaled_to`).
        """
        return self.call(calls.DOWNLOAD_PHOTO, requests.DownloadPhotoRequest(scene_id, version, view))

    def localize(
        self,
        scene_id: str,
        photos: Sequence[Path | bytes],
        *,
        focals: Sequence[float] = (),
        poses: Sequence[Pose] = (),
        version: str = "",
        timeout_s: float | None = None,
    ) -> Localization:
        """Where photos were taken in a scene, how sure that is, what is seen from there, and what they show that the
        scene does not; a photo without a sure place comes back with the reason.

        Args:
            photos: image files, or their bytes.
            focals: focal length of each photo, pixels of the upright photo; one number is that of all; none: found out.
            poses: roughly where each was taken, in any one frame, scene units, OpenCV camera axes: the photos find
                their place together; none: each by itself.
            version: of the scene; "" is the current one.
            timeout_s: when to give up; the first request to a scene takes longer.
        """
        form = _form(photos, focals, poses, version=version)
        path = f"{scene_path(scene_id)}:localize"
        answer = self._transport.call("POST", path, content=lambda: {"files": form}, timeout_s=timeout_s)
        return read(Localization, answer)

    def observe(
        self,
        scene_id: str,
        photos: Sequence[Path | bytes],
        *,
        focals: Sequence[float] = (),
        poses: Sequence[Pose] = (),
        seen_at: datetime | None = None,
        request_id: str = "",
        timeout_s: float = 600.0,
    ) -> Observation:
        """Keep photos of another day, and what they show to be gone, moved, new or changed, with a scene; `undo_edit`
        takes the newest back.

        Args:
            photos: image files, or their bytes; two at least.
            focals, poses: as for `localize`.
            seen_at: when they were taken, with its time zone; None: by their metadata, or now.
            request_id: the same id with the same photos returns the same observation; "": a new one.
            timeout_s: when to give up; ten photos take two cores half a minute, slow ones more.
        """
        seen = {} if seen_at is None else {"seen_at": seen_at.isoformat()}
        form = _form(photos, focals, poses, request_id=request_id or uuid.uuid4().hex, **seen)
        path = f"{scene_path(scene_id)}/observations"
        answer = self._transport.call("POST", path, content=lambda: {"files": form}, timeout_s=timeout_s)
        return read(Observation, answer)

    def observations(self, scene_id: str, *, version: str = "") -> Iterator[Observation]:
        """What photos of other days said of a scene, the newest photos first, page by page."""
        pages = self._pages(calls.LIST_OBSERVATIONS, ListObservationsRequest(scene_id, version))
        return (each for page in pages for each in page.observations)

    def observation(self, scene_id: str, observation_id: str, *, version: str = "") -> Observation:
        """What photos of another day said of a scene. Their own files: `photo` of their `view`."""
        return self.call(calls.GET_OBSERVATION, GetObservationRequest(scene_id, version, observation_id))

    def next_photos(self, scene_id: str, version: str = "") -> tuple[NextPhoto, ...]:
        """Where to stand for the next photos of a scene: at most three places, the most useful first."""
        return self.call(calls.LIST_NEXT_PHOTOS, requests.ListNextPhotosRequest(scene_id, version)).photos

    def best_views(
        self, scene_id: str, things: int | Sequence[int] = (), *, text: str = "", max_views: int = 0, version: str = ""
    ) -> tuple[BestView, ...]:
        """Which of the scene's cameras show some things best, best first, and where in their pictures those are.

        Args:
            things: ids of things or parts, seen together.
            text: instead of `things`: those that answer it.
            max_views: at most so many, up to 16; 0: three.
            version: of the scene; "" is the current one.
        """
        ids = (things,) if isinstance(things, int) else tuple(things)
        request = requests.ListBestViewsRequest(scene_id, version, ids, text, max_views)
        return self.call(calls.LIST_BEST_VIEWS, request).views


def _form(
    photos: Sequence[Path | bytes], focals: Sequence[float], poses: Sequence[Pose], **texts: str
) -> list[tuple[str, tuple[str | None, bytes | str]]]:
    """The parts of a form with photos."""
    sent = [photo.read_bytes() if isinstance(photo, Path) else photo for photo in photos]
    form: list[tuple[str, tuple[str | None, bytes | str]]] = [
        ("photos", (f"photo{number}", content)) for number, content in enumerate(sent)
    ]
    form += [("focals", (None, repr(float(focal)))) for focal in focals]
    form += [("poses", (None, json.dumps(to_plain(pose)))) for pose in poses]
    return [*form, *((name, (None, text)) for name, text in texts.items())]
