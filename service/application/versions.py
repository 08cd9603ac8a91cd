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
from fastsplat.service.application.validate import check_request_id, check_texts
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
    """The versions of scenes. Every method is safe from any thread."""

    def __init__(self, store: Store, settings: Settings, scenes: OpenScenes) -> None:
        self._store = store
        self._settings = settings
        self._scenes = scenes

    def edit(self, scene_id: str, edits: Sequence[Edit], request_id: str = "") -> SceneVersion:
        """Make a new version of a scene: the edits in order, all or none; the version is durable and current on return.

        Beyond `CallSettings.max_versions`, undone versions and then the oldest ones are removed; never the trained one.

        Questions that are being answered keep the version they began with.

        Args:
            scene_id: which scene.
            edits: at least one.
            request_id: the same id with the same edits returns the version that they made; "" for none.

        Raises:
            NotFoundError: there is no such scene, label or object.
            NotReadyError: its training has not finished, or has failed.
            InvalidInputError: an edit that makes no sense.
            LimitExceededError: too many edits, or duplicates that make the scene too large.
            ConflictError: the request id was used before for other edits.
        """
        self._check(edits, request_id)
        rows = [to_plain(edit) for edit in edits]
        digest = hashlib.sha256(json.dumps(rows, sort_keys=True).encode()).hexdigest()
        current = self._scenes.version(scene_id, "")
        with self._store.blobs.exclusive(scene_id):  # edits of one scene queue: each is made of the one before
            for remaining in reversed(range(_TRIES)):
                current = self._scenes.version(scene_id, "")
                earlier = self._store.versions.made_by(scene_id, request_id, digest)
                if earlier is not None:
                    return self._in_force(earlier, current)
                try:
                    made = self._make(scene_id, current, edits, request_id, digest, rows)
                except ConflictError:  # a server on another machine was faster; this one is made of its result
                    if not remaining:
                        raise
                else:
                    self._prune(scene_id)
                    return made
        raise AssertionError

    def undo(self, scene_id: str, version: str = "") -> SceneVersion:
        """Go back to the version before the current one; returns it.

        Args:
            scene_id: which scene.
            version: undo only if this is the current version, so that a retry undoes once; "" undoes whatever it is.

        Raises:
            NotFoundError, NotReadyError: as `edit`.
            ConflictError: there is nothing to undo, or another version is current.
        """
        current = self._scenes.version(scene_id, "")
        self._store.versions.step_back(scene_id, version or current)
        return next(known for known in self.all(scene_id) if known.current)

    def all(self, scene_id: str) -> tuple[SceneVersion, ...]:
        """Every version of a scene, oldest first.

        Raises:
            NotFoundError, NotReadyError: as `edit`.
        """
        self._scenes.version(scene_id, "")
        scene = self._store.scenes.scene(scene_id)
        return tuple(_version_of(record, scene.version) for record in self._store.versions.of(scene))

    def resolve(self, scene_id: str, version: str = "") -> str:
        """The name of a version that can be read; "" stands for the current one.

        Raises:
            NotFoundError, NotReadyError: as `Answers.query`.
        """
        return self._scenes.version(scene_id, version)

    def _prune(self, scene_id: str) -> None:
        for version in self._store.versions.prune(scene_id, self._settings.calls.max_versions):
            self._store.blobs.drop_version(scene_id, version)

    def _named(self, scene_id: str, version: str) -> SceneVersion:
        return next(known for known in self.all(scene_id) if known.version == version)

    def _in_force(self, earlier: VersionRecord, current: str) -> SceneVersion:
        """The version that a request id made, if the current one is it or was made of it.

        Raises:
            ConflictError: it was undone.
        """
        parents = {known.version: known.parent for known in self.all(earlier.scene_id)}
        version = current
        while version and version != earlier.version:
            version = parents.get(version, "")
        if not version:
            raise ConflictError(
                f"the edit of request id {earlier.request_id!r} was undone; its version was {earlier.version}",
                field="request_id",
                hint="Send the edit under a new request id to make it again.",
            )
        return _version_of(earlier, current)

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
                scene = apply_edit(
                    index,
                    SceneEdit(**{**vars(edit), "transform": matrix}),
                    max_gaussians=self._settings.store.max_gaussians,
                )
            except (InvalidInputError, LimitExceededError, NotFoundError) as error:
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
        check_texts(tuple(edits), "edits")
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
