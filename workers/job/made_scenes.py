"""Folders of drafts and finished scenes, with repeated edits of an earlier draft.

Contents: `artefact/`, `scene.ply`, `photos/`, `summary.json`, and such a folder per edited version below `carried/`.
The supervisor lists the edits in the work folder's `EDITS`, as the trainer has no database.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from fastsplat.service.common.files import atomic_file
from fastsplat.service.settings import CallSettings
from fastsplat.service.store.repositories.version_repository import NewVersion, VersionRecord
from fastsplat.service.store.rows.records import SceneSummary

SUMMARY = "summary.json"
EDITS = "edits.json"
DRAFTS = "drafts"
CARRIED = "carried"
_OF_SCENE = ("gaussians", "scale", "dictionary", "cameras", "quality", "objects")


@dataclass(frozen=True)
class EditedVersion:
    """A version edited from a draft or from another such version."""

    version: str
    folder: str  # on this machine
    edits: Sequence[Mapping[str, Any]]  # as JSON
    author: str
    request_id: str
    request_digest: str


@dataclass(frozen=True)
class EditedDraft:
    """A draft's folder on this machine and one or more edited versions, newest last."""

    folder: str
    versions: Sequence[EditedVersion]


def edited_draft(records: Sequence[VersionRecord], find: Callable[[str], Path]) -> EditedDraft | None:
    """Returns the draft that the current version was edited from; None for a draft.

    `find` returns a version's folder.
    """
    known = {record.version: record for record in records}
    lineage = [record for record in records if record.current]
    while lineage and lineage[-1].parent in known:
        lineage.append(known[lineage[-1].parent])
    versions = tuple(
        EditedVersion(v.version, str(find(v.version)), v.edits, v.author, v.request_id or "", v.request_digest)
        for v in lineage[-2::-1]
    )
    return EditedDraft(str(find(lineage[-1].version)), versions) if versions else None


def write_edited(edited: EditedDraft | None, path: Path) -> None:
    """Writes the edits for the trainer, atomically."""
    with atomic_file(path) as unfinished:
        unfinished.write_text(json.dumps(None if edited is None else asdict(edited)))


def read_edited(path: Path) -> EditedDraft | None:
    """Reads the edits known to the supervisor; None without any."""
    if not path.exists() or (values := json.loads(path.read_text())) is None:
        return None
    return EditedDraft(values["folder"], tuple(EditedVersion(**version) for version in values["versions"]))


@dataclass(frozen=True)
class MadeScene:
    """A scene to publish."""

    summary: SceneSummary
    carried: tuple[NewVersion, ...]  # see `publish_made_within`
    edited: str  # edited version that these edits repeat; "" for none
    lost: tuple[str, ...]  # descriptions of edits that could not be repeated

    @property
    def result(self) -> dict[str, Any] | None:
        """`CreateSceneResult` as JSON; None without edits."""
        return {"carried": len(self.carried), "lost": list(self.lost)} if self.edited else None


def read_made(folder: Path, scene_id: str, version: str, calls: CallSettings, find: Callable[[str], Path]) -> MadeScene:
    """Reads a folder that is, or becomes, `version` of the scene.

    `find` returns the current folder of a version in `carried`.
    """
    # Imported only if a draft was edited.
    from fastsplat.service.jobs.new_versions import new_version
    from fastsplat.service.scene.artefact.scene_files import read_scene

    values = json.loads((folder / SUMMARY).read_text())
    summary = SceneSummary(version=version, **{name: values[name] for name in _OF_SCENE})
    carried: list[NewVersion] = []
    rows = values.get("carried", ())
    before = read_scene(folder / "artefact").objects if rows else None
    for row in rows:
        name, request = row["version"], (row["request_id"], row["request_digest"])
        scene, parent = read_scene(find(name) / "artefact"), carried[-1].version if carried else version
        carried.append(
            new_version(
                scene_id, name, parent, row["edits"], before, scene, row, calls, author=row["author"], request=request
            )
        )
        before = scene.objects
    return MadeScene(summary, tuple(carried), values.get("edited", ""), tuple(values.get("lost", ())))
