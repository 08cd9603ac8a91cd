"""Edits as new versions of a scene: written beside the old one, shown at once, undone by pointing back."""

from __future__ import annotations

import hashlib
import json
import secrets
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from typing import Any

import numpy as np

from fastsplat.service.application.open_scenes import OpenScenes
from fastsplat.service.application.validate import check_request_id
from fastsplat.service.common.cancellation import check_cancelled
from fastsplat.service.query import SceneIndex
from fastsplat.service.scene import Scene, write_ply, write_scene
from fastsplat.service.settings import Settings
from fastsplat.service.store import Store
from fastsplat.service.store.blobs import remove
from fastsplat.service.store.version_repository import NewVersion, VersionRecord
from fastsplat_contract.errors import ConflictError, InvalidInputError, LimitExceededError, NotFoundError
from fastsplat_contract.json_codec import from_plain, to_plain
from fastsplat_contract.poses import Pose, Quaternion, Vector3
from fastsplat_contract.scenes import Color, Edit, SceneVersion

_TRIES = 5


class Versions:
    """The versions of scenes; see `SceneService` for each call."""

    def __init__(self, store: Store, settings: Settings, scenes: OpenScenes) -> None:
        self._store = store
        self._settings = settings
        self._scenes = scenes

    def edit(self, scene_id: str, edits: Sequence[Edit], request_id: str) -> SceneVersion:
        """The version that the edits make, or made before; raises as `SceneService.edit_scene`."""
        self._check(edits, request_id)
        rows = [to_plain(edit) for edit in edits]
        digest = hashlib.sha256(json.dumps(rows, sort_keys=True).encode()).hexdigest()
        for left in reversed(range(_TRIES)):
            current = self._scenes.version(scene_id, "")
            earlier = self._store.versions.made_by(scene_id, request_id, digest)
            if earlier is not None:
                return _version_of(earlier, current)
            self._check_room(scene_id)
            try:
                return self._make(scene_id, current, edits, request_id, digest, rows)
            except ConflictError:  # another edit was faster; this one is made of its result
                if not left:
                    raise
        raise AssertionError

    def undo(self, scene_id: str, expected: str) -> SceneVersion:
        """The version before the current one, now current; raises as `SceneService.undo_edit`."""
        current = self._scenes.version(scene_id, "")
        self._store.versions.step_back(scene_id, expected or current)
        return next(version for version in self.all(scene_id) if version.current)

    def all(self, scene_id: str) -> tuple[SceneVersion, ...]:
        """Every version, oldest first; raises as `SceneService.list_versions`."""
        self._scenes.version(scene_id, "")
        scene = self._store.scenes.scene(scene_id)
        return tuple(_version_of(record, scene.version) for record in self._store.versions.of(scene))

    def _named(self, scene_id: str, version: str) -> SceneVersion:
        return next(known for known in self.all(scene_id) if known.version == version)

    def _make(
        self,
        scene_id: str,
        parent: str,
        edits: Sequence[Edit],
        request_id: str,
        digest: str,
        rows: Sequence[Mapping[str, Any]],
    ) -> SceneVersion:
        edited, counts = self._scenes.reading(scene_id, parent, lambda index, _: self._apply(index, edits))
        version = f"e{secrets.token_hex(8)}"
        dictionary = [
            {**row, "gaussian_count": counts[row["label_id"]]} for row in self._store.scenes.scene(scene_id).dictionary
        ]
        self._write(edited, scene_id, version)
        try:
            self._store.versions.publish(
                NewVersion(scene_id, version, parent, request_id, digest, len(edited.gaussians), dictionary, rows)
            )
        except BaseException:
            self._store.blobs.drop_version(scene_id, version)
            raise
        return self._named(scene_id, version)

    def _apply(self, index: SceneIndex, edits: Sequence[Edit]) -> tuple[Scene, list[int]]:
        from fastsplat.service.query.edits import Edit as SceneEdit
        from fastsplat.service.query.edits import apply_edit

        for number, edit in enumerate(edits):
            matrix = None if edit.transform is None else edit.transform.matrix()
            try:
                scene = apply_edit(index, SceneEdit(**{**vars(edit), "transform": matrix}))
            except (InvalidInputError, NotFoundError) as error:
                raise error.within(f"edits[{number}]") from error
            index = self._scenes.index_of(scene)
            check_cancelled()
        classes = np.bincount(index.gaussian_classes, minlength=len(index.scene.dictionary) + 1)
        return index.scene, classes.tolist()

    def _write(self, scene: Scene, scene_id: str, version: str) -> None:
        """The version's folder, whole or not at all; a scratch folder that is left behind counts as an upload."""
        scratch = self._store.blobs.upload(version)
        try:
            scratch.mkdir(parents=True)
            write_scene(scene, scratch / "artefact")
            write_ply(scene.gaussians, scratch / "scene.ply")
            self._store.blobs.publish(scratch, scene_id, version)
        finally:
            remove(scratch)

    def _check(self, edits: Sequence[Edit], request_id: str) -> None:
        check_request_id(request_id)
        limit = self._settings.calls.max_edits
        if not edits:
            raise InvalidInputError("no edits", field="edits", hint="Send at least one.")
        if len(edits) > limit:
            raise LimitExceededError(
                f"{len(edits)} edits",
                field="edits",
                limit=f"{limit} edits (FASTSPLAT_CALLS__MAX_EDITS)",
                hint="Send them in several requests.",
            )

    def _check_room(self, scene_id: str) -> None:
        limit = self._settings.calls.max_versions
        if len(self.all(scene_id)) >= limit:
            raise LimitExceededError(
                f"scene {scene_id!r} has {limit} versions",
                field="scene",
                limit=f"{limit} versions (FASTSPLAT_CALLS__MAX_VERSIONS)",
                hint="Post the scene again, or raise the limit.",
            )


def _version_of(record: VersionRecord, current: str) -> SceneVersion:
    return SceneVersion(
        scene_id=record.scene_id,
        version=record.version,
        parent=record.parent,
        created_at=datetime.fromtimestamp(record.created_at, UTC),
        gaussians=record.gaussians,
        current=record.version == current,
        edits=tuple(_edit_of(row) for row in record.edits),
    )


def _edit_of(row: Mapping[str, Any]) -> Edit:
    if "colour" not in row:
        return from_plain(Edit, row)
    # A row of before the first release of the contract: British names, numbers in lists.
    color, transform = row["colour"], row["transform"]
    return Edit(
        "recolor" if row["action"] == "recolour" else row["action"],
        row["label"],
        row["object_id"],
        color and Color(*color),
        transform and Pose(Vector3(*transform["position"]), Quaternion(*transform["orientation"])),
    )
