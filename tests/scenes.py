"""The one builder of small scenes for all tests: labelled Gaussians, and their way into a store."""

from __future__ import annotations

import uuid
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from PIL import Image

from fastsplat.service.capture.photos.scene_photos import photo_path
from fastsplat.service.common.dictionary import Dictionary, dictionary_of
from fastsplat.service.jobs.new_versions import content_of
from fastsplat.service.perception.results import TextEncoder
from fastsplat.service.query.language.meaning.embeddings import embed_labels
from fastsplat.service.scene.artefact.scene import Evidence, Gaussians, Scene, SemanticHead
from fastsplat.service.scene.artefact.scene_files import write_scene
from fastsplat.service.scene.formats.ply import write_ply
from fastsplat.service.scene.objects.label_evidence import UNIT, evidence_of
from fastsplat.service.settings import Settings
from fastsplat.service.store.queue.claims import Claim
from fastsplat.service.store.rows.codec import camera_to_json
from fastsplat.service.store.rows.records import NewJob, SceneSummary
from fastsplat.service.store.store import Store
from fastsplat_contract.geometry.camera import PosedCamera
from fastsplat_contract.jobs.job_watching import Provisional

EMBEDDING_SIZE = 16  # of label embeddings that no encoder made


def labelled_scene(
    means: ArrayLike,
    label_ids: ArrayLike,
    labels: Sequence[str] | Dictionary,
    *,
    scales: ArrayLike = 0.12,
    quats: ArrayLike = (1.0, 0.0, 0.0, 0.0),
    logit_opacities: ArrayLike = 6.0,
    sh: ArrayLike = 0.0,
    code_size: int = 0,
    undetected_bias: float = 0.0,
    encoder: TextEncoder | None = None,
    templates: Sequence[str] = ("{}",),
    cameras: Sequence[PosedCamera] = (),
    **fields: Any,
) -> Scene:
    """Makes a scene of one-hot codes: Gaussian g has label `label_ids[g]` with a logit of 8.

    Arguments may be one value or [G, ...]; a number as `sh` fills [G, 1, 3]; `code_size` 0: one a class; no `encoder`:
    zero embeddings; `others`: further fields of `Scene`.
    """
    dictionary = labels if isinstance(labels, Dictionary) else dictionary_of(labels)
    classes = len(dictionary) + 1
    ids = np.asarray(label_ids)
    count = len(ids)
    one_hot = np.eye(classes, code_size or classes, dtype=np.float32)
    bias = np.zeros(classes, dtype=np.float32)
    bias[0] = undetected_bias
    if encoder is None:
        embeddings = np.zeros((len(dictionary), EMBEDDING_SIZE), dtype=np.float32)
    else:
        embeddings = embed_labels(dictionary, encoder, templates)
    return Scene(
        gaussians=Gaussians(
            means=np.asarray(means, dtype=np.float32),
            quats=_filled(quats, count, 4),
            log_scales=np.log(_filled(scales, count, 3, dtype=np.float64)).astype(np.float32),
            logit_opacities=_filled(logit_opacities, count),
            sh=_filled(sh, count, 1, 3) if np.ndim(sh) == 0 else np.asarray(sh, dtype=np.float32),
            codes=one_hot[ids],
        ),
        head=SemanticHead(8.0 * one_hot, bias),
        dictionary=dictionary,
        label_embeddings=embeddings,
        label_templates=tuple(templates),
        text_encoder=("another", "1" * 64) if encoder is None else (encoder.name, encoder.sha256),
        cameras=tuple(cameras),
        **{"scale": "METRIC", **fields},
    )


def evidence_from_dense(sums: np.ndarray) -> Evidence:
    """Σ w·1[label = n] in pixels, [G, C], as counts."""
    rows, labels = np.nonzero(sums)
    return evidence_of(rows, labels, np.rint(sums[rows, labels] * UNIT).astype(np.int64), len(sums))


def finish_job(
    store: Store,
    operation_id: str,
    scene: Scene,
    *,
    version: str = "1",
    stages: Sequence[Mapping[str, Any]] = (),
    draft: Provisional | None = None,
    **row: Any,
) -> None:
    """Reports `stages`, then ends a queued job with `scene` (a `draft`: it goes on); `row` is added to each label's."""
    claim = store.jobs.claim(operation_id)
    scene = scene if draft is None else replace(scene, facts=replace(scene.facts, draft=draft))
    folder = store.blobs.version(store.scenes.operation(operation_id).scene_id, version)
    write_version(scene, folder)
    if stages:
        store.jobs.report(claim, [dict(stage) for stage in stages])
    counts = np.bincount(scene.gaussians.codes.argmax(axis=1), minlength=len(scene.dictionary) + 1)
    content = content_of(scene, counts.tolist())
    rows = [{**label, **row} for label in content["dictionary"]]
    cameras = [camera_to_json(posed) for posed in scene.cameras]
    quality = scene.facts.with_quality(scene.quality)
    summary = SceneSummary(version, len(scene.gaussians), scene.scale, rows, cameras, quality, content["objects"])
    if draft is None:
        store.jobs.succeed(claim, summary)
    else:
        store.jobs.publish_draft(claim, summary)


def store_scene(store: Store, scene: Scene, name: str = "made", *, project: str = "default", **options: Any) -> str:
    """Store a scene as a job that succeeded; returns its id. `options`: as `finish_job`."""
    job = replace(queued_job(name), project=project)
    store.scenes.create(job)
    finish_job(store, job.operation_id, scene, **options)
    return job.scene_id


def add_photos(store: Store, scene_id: str, pictures: Sequence[Image.Image]) -> None:
    """Put photos into the current version of a scene, one a camera, in order, as a worker that stores photos would."""
    folder = store.blobs.version(scene_id, store.scenes.scene(scene_id).version)
    for number, picture in enumerate(pictures):
        path = photo_path(folder, number)
        path.parent.mkdir(exist_ok=True)
        picture.save(path, quality=90)


def queued_job(name: str = "") -> NewJob:
    """A job that asks for nothing special and has no files."""
    return NewJob(
        scene_id=uuid.uuid4().hex,
        operation_id=uuid.uuid4().hex,
        name=name,
        request_id="",
        request_digest="",
        upload_id=uuid.uuid4().hex,
        options={"labels": [], "time_budget_s": None, "max_gaussians": None},
    )


def claimed_job(store: Store, job: NewJob | None = None) -> Claim:
    """A job that a worker has just taken: this one, or one like `queued_job`."""
    job = job or queued_job()
    store.scenes.create(job)
    claim = store.jobs.claim(job.operation_id)
    assert claim is not None
    return claim


def write_version(scene: Scene, folder: Path) -> None:
    """The files of a version: the artefact, and the PLY."""
    write_scene(scene, folder / "artefact")
    write_ply(scene.gaussians, folder / "scene.ply")


def _filled(values: ArrayLike, *shape: int, dtype: Any = np.float32) -> np.ndarray:
    return np.broadcast_to(np.asarray(values, dtype=dtype), shape).copy()


def stand_in_models(models: Path, *names: str) -> Path:
    """Makes folders of models that no test opens: those that photos need; `names` are the real ones where they are."""
    for name in ("picodet_416", "mobile_sam", "grounding_dino_tiny", *names):
        if name in names and (real := Settings().models / name).is_dir():
            (models / name).symlink_to(real)
        else:
            (models / name).mkdir(parents=True, exist_ok=True)
            (models / name / "stand-in").touch()
    return models
