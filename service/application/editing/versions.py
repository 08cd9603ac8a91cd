"""Versioned edits of a scene: written beside the old version, undone by pointing back."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from fastsplat.service.application.answering.project_context import ProjectContext
from fastsplat.service.application.base.memory import edit_bytes
from fastsplat.service.application.base.validate import check_request_id, check_texts
from fastsplat.service.application.editing.prompted_edits import PromptedEdits
from fastsplat.service.application.editing.version_files import new_version_name, write_version
from fastsplat.service.application.editing.version_rows import ASKS_KIND, PROMPTED, check_edits, version_of
from fastsplat.service.common.cancellation import check_cancelled
from fastsplat.service.jobs.new_versions import content_of, new_version
from fastsplat.service.query.scene_index import SceneIndex
from fastsplat.service.scene.artefact.scene import Objects
from fastsplat.service.store.repositories.version_repository import VersionRecord
from fastsplat_contract.codec.json_codec import to_plain
from fastsplat_contract.errors import (
    ConflictError,
    DatabaseError,
    InvalidInputError,
    LimitExceededError,
    NotFoundError,
    NotReadyError,
    ObjectStoreError,
)
from fastsplat_contract.geometry.object_prompts import PromptedObject
from fastsplat_contract.messages.edit_previews import EditPreview
from fastsplat_contract.messages.scenes import Edit, InsertSource, SceneVersion

_TRIES = 5
_LEASE_S = 30.0
"""Edits of a scene wait for each other on all servers; after a crash, or a longer one, the next begins after this."""


@dataclass(frozen=True)
class VersionOrder:
    """Order for a new version, the edits also as JSON; see `Versions.edit`."""

    scene_id: str
    edits: Sequence[Edit]
    rows: Sequence[Mapping[str, Any]]
    digest: str
    request_id: str
    looked_at: str
    author: str


class Versions:
    """Versions of scenes. Thread-safe."""

    def __init__(self, context: ProjectContext, prompted: PromptedEdits) -> None:
        self._context = context
        self._prompted = prompted

    def edit(
        self, scene_id: str, edits: Sequence[Edit], request_id: str = "", looked_at: str = "", author: str = ""
    ) -> SceneVersion:
        """Applies edits in order, all or none, as a new current version; durable on return.

        Running queries keep the version they began with. Beyond `CallSettings.max_versions`, undone versions and then
        the oldest ones are removed, never the trained one.

        Args:
            request_id: the same id with the same edits returns the version that they made; "" for none.
            looked_at: version that the editor has seen, "" for none; see `EditIn.version`.
            author: id of the caller's key; "" for none.

        Raises:
            NotFoundError: no such scene, version, label or object.
            NotReadyError: its training has not finished, or has failed.
            InvalidInputError: an invalid edit.
            LimitExceededError: too many edits, too many Gaussians, or too much memory.
            ConflictError: the request id was used for other edits, or a person gave an object another name.
            ModelUnavailableError: the segmenter for an edit's prompt is missing.
        """
        check_request_id(request_id)
        rows = check_edits(edits)
        check_texts(looked_at, "version")
        self._prompted.check(edits)
        digest = hashlib.sha256(json.dumps(rows, sort_keys=True).encode()).hexdigest()
        self._context.scenes.version(scene_id, "")
        with self._context.store.workers.exclusive(f"edit {scene_id}", _LEASE_S):  # else most would conflict
            for remaining in reversed(range(_TRIES)):
                earlier = self._context.store.versions.made_by(scene_id, request_id, digest)
                if earlier is not None:
                    return self.in_force(earlier)
                current = self._context.scenes.version(scene_id, "")
                try:
                    return self._make(
                        VersionOrder(scene_id, edits, rows, digest, request_id, looked_at, author), current
                    )
                except ConflictError:  # a concurrent undo, job or too long an edit: retry on its result
                    if not remaining:
                        raise
        raise AssertionError

    def preview(self, scene_id: str, edits: Sequence[Edit], version: str = "") -> EditPreview:
        """Gaussians that edits would remove, by the code that removes them; raises as `edit`."""
        from fastsplat.service.query.edits.apply_edit import preview_of  # scipy loads with the first

        check_edits(edits)
        check_texts(version, "version")
        index, read_version = self._context.scenes.open(scene_id, version)
        with self._context.memory.reserve(edit_bytes(index.scene, ()), "edits"):
            return preview_of(index, read_version, edits)

    def undo(self, scene_id: str, version: str = "") -> SceneVersion:
        """Makes the current version's parent current; `ConflictError` unless `version` ("": any) is current."""
        self._context.scenes.version(scene_id, "")
        return version_of(self._context.store.versions.step_back(scene_id, version))

    def redo(self, scene_id: str, version: str = "") -> SceneVersion:
        """Makes the last current child of the current version current; raises as `undo`.

        Undone versions survive an edit and can be restored.
        """
        self._context.scenes.version(scene_id, "")
        return version_of(self._context.store.versions.step_forward(scene_id, version))

    def restore(self, scene_id: str, version: str, expected: str = "") -> SceneVersion:
        """Makes any version current in place of `expected` ("": any); all others stay.

        Raises:
            InvalidInputError: no version is named.
            ConflictError: another version than the expected one is current.
        """
        self._context.scenes.version(scene_id, "")
        check_texts((version, expected), "version")
        if not version:
            raise InvalidInputError("no version", field="version", hint="Name one of the scene's versions.")
        return version_of(self._context.store.versions.restore(scene_id, version, expected))

    def all(self, scene_id: str) -> tuple[SceneVersion, ...]:
        """Every version of a scene, oldest first; authors are hidden from single-scene keys."""
        self._context.scenes.version(scene_id, "")
        scene = self._context.store.scenes.scene(scene_id)
        versions = tuple(version_of(record) for record in self._context.store.versions.of(scene))
        # Users of a link to one scene must not see who made it.
        return (
            tuple(replace(version, author="") for version in versions) if self._context.store.only_scene else versions
        )

    def resolve(self, scene_id: str, version: str = "") -> str:
        """Name of a readable version ("": the current one); raises as `Answers.query`."""
        return self._context.scenes.version(scene_id, version)

    def in_force(self, earlier: VersionRecord) -> SceneVersion:
        """Version made by a request id; raises `ConflictError` if it was undone."""
        versions = {known.version: known for known in self.all(earlier.scene_id)}
        version = next((known.version for known in versions.values() if known.current), "")
        while version in versions and version != earlier.version:
            version = versions[version].parent
        if version not in versions:
            raise ConflictError(
                f"the edit of request id {earlier.request_id!r} was undone; its version was {earlier.version}",
                field="request_id",
                hint="Send the edit under a new request id to make it again.",
            )
        return versions[version]

    def _make(self, order: VersionOrder, parent: str) -> SceneVersion:
        seen: Objects | None = None
        if order.looked_at:
            seen = self._context.scenes.open(order.scene_id, order.looked_at)[0].objects.table
        before = self._context.scenes.open(order.scene_id, parent)[0]
        sources = self._sources(order.edits)  # before reserving, as opening a scene reserves its own memory
        size = edit_bytes(before.scene, (source.scene for source in sources.values()))
        size += self._prompted.bytes(order.edits, len(before.scene.gaussians))
        with self._prompted.running(), self._context.memory.reserve(size, "edits"):
            index, new_objects = self._apply(before, order.edits, seen, sources)
            rows = [
                {
                    **row,
                    **({PROMPTED: new_objects[number]} if number in new_objects else {}),
                    **({ASKS_KIND: True} if edit.name is not None and not index.is_understood(edit.name) else {}),
                }
                for number, (edit, row) in enumerate(zip(order.edits, order.rows, strict=True))
            ]
            return self.publish(replace(order, rows=rows), parent, before, index)

    def publish(
        self,
        order: VersionOrder,
        parent: str,
        before: SceneIndex,
        index: SceneIndex,
        version: str = "",
        add_files: Callable[[Path], None] = lambda folder: None,
    ) -> SceneVersion:
        """Stores `index` as the current version of a scene.

        Args:
            parent, before: the current version and its index.
            version: from `new_version_name`; "": a new name.
            add_files: adds further files before the folder is published.

        Raises:
            ConflictError: another version became current; nothing of this one is kept.
            NotFoundError: the scene was deleted.
        """
        scene_id = order.scene_id
        edited = index.scene
        version = version or new_version_name()
        same = edited.gaussians is before.scene.gaussians
        folder = self._context.scenes.folder(scene_id, parent)
        write_version(edited, self._context.store.blobs, scene_id, version, folder, same, add_files)
        key = self._context.store.keys.find(order.author) if order.author else None
        try:
            published, removed = self._context.store.versions.publish(
                new_version(
                    scene_id,
                    version,
                    parent,
                    order.rows,
                    before.scene.objects,
                    edited,
                    content_of(edited, index.label_counts),
                    self._context.settings.calls,
                    sizes=index.ranked.sizes,
                    author=key.name if key is not None else "",
                    request=(order.request_id, order.digest),
                )
            )
        except BaseException:
            # The transaction may have committed though its answer was lost: then the folder is needed. If the database
            # still does not answer, a worker's cleanup decides.
            with suppress(DatabaseError):
                if not self._context.store.versions.is_published(scene_id, version):
                    self._context.store.blobs.drop_version(scene_id, version)
            raise
        with suppress(ObjectStoreError):  # leftovers are removed by a worker's cleanup
            for old in removed:
                self._context.store.blobs.drop_version(scene_id, old)
        self._context.scenes.keep(scene_id, version, index)
        return version_of(published)

    def _apply(
        self, index: SceneIndex, edits: Sequence[Edit], seen: Objects | None, sources: Mapping[int, SceneIndex]
    ) -> tuple[SceneIndex, dict[int, dict[str, Any]]]:
        """Index of the edited scene, and results of prompts as JSON, by edit number."""
        from fastsplat.service.query.edits.apply_edit import apply_edit

        before = index.objects.table
        new_objects: dict[int, dict[str, Any]] = {}
        for number, edit in enumerate(edits):
            try:
                piece = self._prompted.piece(index, edit)
                most = self._context.settings.store.max_gaussians
                rows = None if piece is None else piece.rows
                scene = apply_edit(index, edit, seen, before, sources.get(number), max_gaussians=most, piece=rows)
                if len(scene.gaussians) > max(len(index.scene.gaussians), most):
                    hint = "Add fewer, or remove some first."
                    given = f"{len(scene.gaussians)} Gaussians"
                    raise LimitExceededError(given, field="object_ids", limit=f"{most}", hint=hint)
                self._context.memory.check(edit_bytes(scene, ()), "objects")
            except (InvalidInputError, NotFoundError, NotReadyError, LimitExceededError, ConflictError) as error:
                raise error.within(f"edits[{number}]") from error
            index = index.after(scene)
            if piece is not None:
                new_id = index.objects.table.table[-1].id
                new_objects[number] = to_plain(PromptedObject(number, new_id, len(piece.rows), piece.views))
            check_cancelled()
        return index, new_objects

    def _sources(self, edits: Sequence[Edit]) -> dict[int, SceneIndex]:
        """Source scenes of insertions, by edit number."""
        sources = {}
        for number, edit in enumerate(edits):
            if edit.source is not None and edit.action == "insert":
                try:
                    sources[number] = self._source(edit.source)
                except (NotFoundError, NotReadyError) as error:
                    raise error.within(f"edits[{number}]") from error
        return sources

    def _source(self, source: InsertSource) -> SceneIndex:
        try:
            return self._context.scenes.open(source.scene_id, source.version)[0]
        except (NotFoundError, NotReadyError) as error:
            raise error.within("source") from error
