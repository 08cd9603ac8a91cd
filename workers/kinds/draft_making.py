"""Makes drafts of a scene while the stages of its job run."""

from __future__ import annotations

import itertools
import json
import secrets
import shutil
import sys
import traceback
from collections.abc import Callable, Sequence
from dataclasses import fields
from functools import partial
from pathlib import Path
from typing import Any

from fastsplat.service.capture.captures import Capture
from fastsplat.service.capture.photos.scene_photos import share_photos
from fastsplat.service.common.atomic import link_or_copy
from fastsplat.service.jobs.drafts import DraftVersion, carry_edits, first_draft, training_draft
from fastsplat.service.jobs.new_versions import content_of
from fastsplat.service.perception.label_maps.early_look import EARLY_VIEWS, covering_order
from fastsplat.service.perception.results import Labelling
from fastsplat.service.perception.text.open_text_encoder import open_text_encoder
from fastsplat.service.query.scene_index import SceneIndex
from fastsplat.service.scene.artefact.scene import DRAFTS as PLAN
from fastsplat.service.scene.artefact.scene import Scene, provisional_of
from fastsplat.service.scene.artefact.scene_files import read_scene, write_scene
from fastsplat.service.scene.formats.ply import write_ply
from fastsplat.service.settings import Settings
from fastsplat.service.splatting.results import TrainedSplats
from fastsplat.service.store.blobs.blobs import remove
from fastsplat.service.store.rows.codec import camera_to_json
from fastsplat.workers.job.made_scenes import CARRIED, DRAFTS, EDITS, SUMMARY, read_edited
from fastsplat.workers.job.protocol import Job
from fastsplat.workers.job.results import KEPT, RESULT_FILES
from fastsplat.workers.kinds.progress_files import ProgressFiles
from fastsplat_contract.codec.json_codec import from_plain, to_plain
from fastsplat_contract.errors import CancelledError, ConflictError, FastSplatError
from fastsplat_contract.jobs.job_watching import Provisional
from fastsplat_contract.messages.scenes import Edit

_OF_EDIT = {field.name for field in fields(Edit)}
"""Fields of an edit; version rows also hold results of prompts."""


def training_drafts() -> tuple[float, ...]:
    """Training progress, 0..1, at which drafts are due."""
    return tuple(draft.fraction for draft in PLAN if draft.stage == "training")


def early_views(capture: Capture, labelling: Labelling) -> Sequence[int]:
    """Selects the views used for drafts: those masked first."""
    looked_at = [number for number, masks in enumerate(labelling.masks) if masks is not None]
    return covering_order(capture, looked_at or range(len(capture.views)))[:EARLY_VIEWS]


def write_made(scene: Scene, folder: Path) -> None:
    """Writes a scene for publication, without photos."""
    write_scene(scene, folder / "artefact")
    write_ply(scene.gaussians, folder / "scene.ply")
    (folder / SUMMARY).write_text(json.dumps(_summary(scene)))


def carry_into(job: Job, scene: Scene, folder: Path) -> Sequence[str]:
    """Repeats the newest draft's edits beside a written scene; describes those that failed."""
    edited = read_edited(job.folder / EDITS)
    if edited is None:
        _note(folder, "", (), ())
        return ()
    settings, encoder = job.settings, open_text_encoder(scene.text_encoder[0], job.settings.models)
    opened = partial(SceneIndex, encoder=encoder, settings=settings.query)
    draft, versions = opened(read_scene(Path(edited.folder) / "artefact")), []
    for version in edited.versions:
        edits = [from_plain(Edit, {name: row[name] for name in row if name in _OF_EDIT}) for row in version.edits]
        versions.append(DraftVersion(edits, opened(read_scene(Path(version.folder) / "artefact"))))
    carried = carry_edits(opened(scene), draft, versions, max_gaussians=settings.store.max_gaussians)
    rows: list[dict[str, Any]] = []
    for each in carried.versions:
        before, name = edited.versions[each.number], f"e{secrets.token_hex(8)}"
        place = folder / CARRIED / name
        place.mkdir(parents=True)
        write_made(each.index.scene, place)
        share_photos(folder, place)
        summary = json.loads((place / SUMMARY).read_text())
        rows.append(
            {
                "version": name,
                "edits": [to_plain(edit) for edit in each.edits],
                "author": before.author,
                "request_id": before.request_id,
                "request_digest": before.request_digest,
                **{name: summary[name] for name in ("gaussians", "things", "dictionary")},
            }
        )
    _note(folder, edited.versions[-1].version, rows, carried.lost)
    return carried.lost


def _note(folder: Path, edited: str, rows: Sequence[dict[str, Any]], lost: Sequence[str]) -> None:
    summary = json.loads((folder / SUMMARY).read_text())
    (folder / SUMMARY).write_text(json.dumps({**summary, "edited": edited, "carried": rows, "lost": list(lost)}))


def export_made(job: Job, folder: Path, assemble: Callable[[], None]) -> None:
    """Runs the last stage: the scene, and the repeated edits of its newest draft.

    If only late edits are missing, the kept scene is used and `assemble`, which writes it, is skipped.
    """
    kept = job.folder / f"{folder.name.partition('.')[0]}{KEPT}"
    if kept.is_dir():
        shutil.copytree(kept, folder, copy_function=link_or_copy, ignore=_own, dirs_exist_ok=True)
        (folder / SUMMARY).write_bytes((kept / SUMMARY).read_bytes())  # a copy, because links must not be written to
    else:
        assemble()
    if (job.folder / EDITS).exists():
        carry_into(job, read_scene(folder / "artefact"), folder)


def _own(folder: str, names: list[str]) -> list[str]:
    return [name for name in names if name in (CARRIED, SUMMARY, *RESULT_FILES)]


class Drafts:
    """Publishes drafts of a stage; failures are logged and do not fail the job."""

    def __init__(self, job: Job, files: ProgressFiles) -> None:
        self._job, self._files = job, files
        self._numbers = itertools.count(1)

    def of_points(self, capture: Capture, labelling: Labelling, views: Sequence[int]) -> None:
        self._publish("perception", lambda: first_draft(capture, labelling, views, self._job.settings))

    def of_training(
        self,
        splats: TrainedSplats,
        capture: Capture,
        labelling: Labelling,
        views: Sequence[int],
        settings: Settings,
        share: float,
    ) -> None:
        """Publishes a draft at training progress `share`."""
        provisional = Provisional("training", round(share, 3))
        self._publish("training", lambda: training_draft(splats, capture, labelling, views, settings, provisional))

    def _publish(self, stage: str, make: Callable[[], Scene]) -> None:
        job = self._job
        name = f"{job.folder.name}-{stage}-{job.attempt}-{next(self._numbers)}"
        folder = job.folder / DRAFTS / f".{name}"
        try:
            scene = make()
            folder.mkdir(parents=True)
            write_made(scene, folder)
            if lost := carry_into(job, scene, folder):
                raise ConflictError(f"it would lose edits: {'; '.join(lost)}")  # the finished scene may accept them
            folder.rename(job.folder / DRAFTS / name)
        except CancelledError:
            raise
        except Exception as error:  # any failure: the job continues
            remove(folder)
            print(f"draft {name} is not made: {error}", file=sys.stderr, flush=True)
            if not isinstance(error, (FastSplatError, OSError)):
                traceback.print_exception(error)
            return
        provisional = provisional_of(scene.quality)
        assert provisional is not None
        self._files.draft(name, provisional)


def _summary(scene: Scene) -> dict[str, Any]:
    return {
        **content_of(scene),
        "scale": scene.scale,
        "cameras": [camera_to_json(posed) for posed in scene.cameras],
        "quality": dict(scene.quality),
    }
