"""What a job that makes a scene has made, as folders: a draft or the finished scene, and the edits that people made of
the draft before, made again.

`artefact/`, `scene.ply`, `photos/` and `summary.json`; below `carried/` such a folder for each version of these edits.
Which edits there are the supervisor says in a file of the work folder, `EDITS`, as the trainer knows no database.
"""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from fastsplat.service.settings import CallSettings
from fastsplat.service.store.records import SceneSummary
from fastsplat.service.store.version_repository import NewVersion, VersionRecord

SUMMARY = "summary.json"
EDITS = "edits.json"
DRAFTS = "drafts"
CARRIED = "carried"
_OF_CARRIED = ("gaussians", "things", "dictionary", "edits", "author", "request_id", "request_digest", "version")
_OF_SCENE = ("gaussians", "scale", "dictionary", "cameras", "quality", "things")


@dataclass(frozen=True)
class EditedVersion:
    """A version that people have made of a draft, or of another such version.

    Attributes:
        version: its name.
        folder: on this machine.
        edits: as JSON.
        author, request_id, request_digest: see `VersionRecord`.
    """

    version: str
    folder: str
    edits: Sequence[Mapping[str, Any]]
    author: str
    request_id: str
    request_digest: str


@dataclass(frozen=True)
class EditedDraft:
    """A draft, by its folder on this machine, and what was made of it, the newest last; at least one version."""

    folder: str
    versions: Sequence[EditedVersion]


def edited_draft(records: Sequence[VersionRecord], find: Callable[[str], Path]) -> EditedDraft | None:
    """What the current one of a scene's versions holds beside the draft that it was made of; None if it is a draft.

    Args:
        records: of all its versions.
        find: the folder of a version.
    """
    known = {record.version: record for record in records}
    lineage = [record for record in records if record.current]
    while lineage and lineage[-1].parent in known:
        lineage.append(known[lineage[-1].parent])
    versions = tuple(
        EditedVersion(
            record.version,
            str(find(record.version)),
            record.edits,
            record.author,
            record.request_id or "",
            record.request_digest,
        )
        for record in lineage[-2::-1]
    )
    return EditedDraft(str(find(lineage[-1].version)), versions) if versions else None


def write_edited(edited: EditedDraft | None, path: Path) -> None:
    """Tell the trainer what was edited: whole or not at all."""
    unfinished = path.with_suffix(".part")
    unfinished.write_text(json.dumps(None if edited is None else asdict(edited)))
    os.replace(unfinished, path)


def read_edited(path: Path) -> EditedDraft | None:
    """What was edited, as far as the supervisor has said; None where nothing was."""
    if not path.exists() or (values := json.loads(path.read_text())) is None:
        return None
    return EditedDraft(values["folder"], tuple(EditedVersion(**version) for version in values["versions"]))


@dataclass(frozen=True)
class MadeScene:
    """What is to be published.

    Attributes:
        summary: of the scene.
        carried: see `publish_made_within`.
        edited: the edited version whose edits these are; "" for none.
        lost: what of them could not be made again, in words.
    """

    summary: SceneSummary
    carried: tuple[NewVersion, ...]
    edited: str
    lost: tuple[str, ...]

    @property
    def result(self) -> dict[str, Any] | None:
        """As `CreateSceneResult`; None where nothing was edited."""
        return {"carried": len(self.carried), "lost": list(self.lost)} if self.edited else None


def read_made(folder: Path, scene_id: str, version: str, calls: CallSettings, find: Callable[[str], Path]) -> MadeScene:
    """What a folder holds, that is `version` of the scene, or is to be.

    Args:
        folder: see above.
        scene_id, version: of the scene.
        calls: how many names of people are kept.
        find: the folder of one of the versions in `carried`, wherever it is by now.
    """
    # What a worker needs only where a draft was edited.
    from fastsplat.service.new_versions import new_version
    from fastsplat.service.scene.scene_files import read_scene

    values = json.loads((folder / SUMMARY).read_text())
    of_scene = {name: values[name] for name in _OF_SCENE}
    summary = SceneSummary(version=version, **of_scene)
    carried: list[NewVersion] = []
    rows = values.get("carried", ())
    before = read_scene(folder / "artefact").things if rows else None
    for row in rows:
        scene = read_scene(find(row["version"]) / "artefact")
        parent = carried[-1].version if carried else version
        of_row = {name: row[name] for name in _OF_CARRIED}
        carried.append(new_version(before, scene, calls, scene_id=scene_id, parent=parent, **of_row))
        before = scene.things
    return MadeScene(summary, tuple(carried), values.get("edited", ""), tuple(values.get("lost", ())))
