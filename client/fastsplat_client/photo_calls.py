"""Calls about scenes' photos, visual localization, observations and best views."""

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
    """Photo calls of `Client`."""

    def photos(self, scene_id: str, *, version: str = "") -> Iterator[ScenePhoto]:
        """Lists a scene's stored photos in the order of its cameras."""
        pages = self._pages(calls.LIST_PHOTOS, requests.ListPhotosRequest(scene_id, version))
        return (photo for page in pages for photo in page.photos)

    def photo(self, scene_id: str, view: str, *, version: str = "") -> bytes:
        """Gets a camera's undistorted photo as JPEG; it fits the camera scaled by `Camera.scaled_to`."""
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
        """Localizes photos in a scene: poses, covariances, visible objects and changes.

        Photos that cannot be localized reliably are returned with the reason.

        Args:
            focals: focal length of each photo, or one of all, in pixels of the upright photo; empty: estimated.
            poses: rough pose of each photo in a common frame, scene units, OpenCV camera axes, to localize them
                jointly; empty: each photo on its own.
            timeout_s: the first request to a scene takes longer.
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
        """Adds two or more photos of another day with detected changes; `undo_edit` removes the newest.

        Args:
            focals, poses: as for `localize`.
            seen_at: time of the photos, with time zone; None: from their metadata, or now.
            request_id: makes the call idempotent; "": a new one.
            timeout_s: ten photos take half a minute on two fast cores.
        """
        seen = {} if seen_at is None else {"seen_at": seen_at.isoformat()}
        form = _form(photos, focals, poses, request_id=request_id or uuid.uuid4().hex, **seen)
        path = f"{scene_path(scene_id)}/observations"
        answer = self._transport.call("POST", path, content=lambda: {"files": form}, timeout_s=timeout_s)
        return read(Observation, answer)

    def observations(self, scene_id: str, *, version: str = "") -> Iterator[Observation]:
        """Lists a scene's observations by photos of other days, newest photos first."""
        pages = self._pages(calls.LIST_OBSERVATIONS, ListObservationsRequest(scene_id, version))
        return (observation for page in pages for observation in page.observations)

    def observation(self, scene_id: str, observation_id: str, *, version: str = "") -> Observation:
        """Gets an observation; `photo` of a photo's `view` gets its file."""
        return self.call(calls.GET_OBSERVATION, GetObservationRequest(scene_id, version, observation_id))

    def next_photos(self, scene_id: str, version: str = "") -> tuple[NextPhoto, ...]:
        """Suggests at most three viewpoints for further photos, most useful first."""
        return self.call(calls.LIST_NEXT_PHOTOS, requests.ListNextPhotosRequest(scene_id, version)).photos

    def best_views(
        self, scene_id: str, objects: int | Sequence[int] = (), *, text: str = "", max_views: int = 0, version: str = ""
    ) -> tuple[BestView, ...]:
        """Ranks cameras by how well they show objects together, and locates these in their pictures.

        Args:
            objects: ids of objects or parts.
            text: query that selects objects, instead of `objects`.
            max_views: up to 16; 0: three.
        """
        ids = (objects,) if isinstance(objects, int) else tuple(objects)
        request = requests.ListBestViewsRequest(scene_id, version, ids, text, max_views)
        return self.call(calls.LIST_BEST_VIEWS, request).views


def _form(
    photos: Sequence[Path | bytes], focals: Sequence[float], poses: Sequence[Pose], **texts: str
) -> list[tuple[str, tuple[str | None, bytes | str]]]:
    sent = [photo.read_bytes() if isinstance(photo, Path) else photo for photo in photos]
    form: list[tuple[str, tuple[str | None, bytes | str]]] = [
        ("photos", (f"photo{number}", content)) for number, content in enumerate(sent)
    ]
    form += [("focals", (None, repr(float(focal)))) for focal in focals]
    form += [("poses", (None, json.dumps(to_plain(pose)))) for pose in poses]
    return [*form, *((name, (None, text)) for name, text in texts.items())]
