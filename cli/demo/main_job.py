"""Runs the main job on one capture over REST, and reports it."""

from __future__ import annotations

import json
import time
from collections.abc import Mapping, Sequence
from pathlib import Path

import cv2
import numpy as np
import typer
from numpy.typing import NDArray

from fastsplat.cli.demo.report import print_report, save_pictures
from fastsplat.cli.demo.service_process import running_service
from fastsplat.service.library.job_lines import ProgressLines
from fastsplat.service.settings import Settings
from fastsplat_client import Client
from fastsplat_contract.codec.json_codec import to_plain
from fastsplat_contract.jobs.operations import Operation, SceneOptions
from fastsplat_contract.messages.objects import PickedObject, SceneObject
from fastsplat_contract.messages.queries import Answer, QueryRequest
from fastsplat_contract.messages.scenes import Scene

SAMPLE_PHOTOS = Path(__file__).parent / "photos"
"""The sample capture: 26 photos of a table with objects on it."""

_NAME = "Oskar"
"""A name that no detector knows."""

_SAMPLE_QUESTIONS = ("banana", "coffee", "fruit", "something to read", "bicycle")
"""For the sample capture: an object by its name, three ambiguous questions, and an object that is not there."""

_ABSENT = ("submarine", "volcano", "bicycle")


def run_main_job(
    folder: Path, settings: Settings, *, photos: Path | None, ask: Sequence[str], seconds: float | None
) -> None:
    """Runs the main job into the empty `folder`: report.json, pictures, PLY files, `service`.

    Without `photos` the sample's are taken, without `ask` the sample's questions, or the two leading names of the scene
    and an object that is not there.

    Raises:
        FastSplatError: a port is taken, the service does not start, or what it answers.
        typer.Exit: the job failed; says why.
    """
    started = time.monotonic()
    ports = {"http_port": settings.http_port, "grpc_port": settings.grpc_port}
    with (
        running_service(
            data_dir=folder / "service", models=settings.models.resolve(), log=folder / "service.log", **ports
        ) as key,
        Client(f"http://127.0.0.1:{settings.http_port}", key=key, timeout_s=120.0) as client,
    ):
        scene, operation = _train(client, photos or SAMPLE_PHOTOS, seconds, folder)
        labels = [row.label for row in sorted(scene.dictionary, key=lambda row: -row.gaussian_count)]
        absent = next(word for word in _ABSENT if word not in labels)
        texts = ask or ((*labels[:2], absent) if photos else _SAMPLE_QUESTIONS)
        answers = [_ask(client, scene.id, text) for text in texts]
        objects, view = list(client.objects(scene.id)), scene.cameras[len(scene.cameras) // 2].name
        (folder / "objects.png").write_bytes(client.picture(scene.id, "objects", view))
        if (named := _click_and_name(client, scene.id, view)) is not None:
            typer.echo(f'a click in {view} finds object {named.object.id}, without a name; it is named "{_NAME}"')
            answers.append(_ask(client, scene.id, _NAME))
        report = {
            "scene": to_plain(scene),
            "operation": to_plain(operation),
            "objects": list(map(to_plain, objects)),
            "answers": list(map(to_plain, answers)),
        }
        (folder / "report.json").write_text(json.dumps(report, indent=2, ensure_ascii=False) + "\n")
        save_pictures(client, scene, answers, view, folder)
        print_report(scene, objects, answers)
    typer.echo(f"{time.monotonic() - started:.0f} s in all, downloads aside; everything is in {folder}/")


def _train(client: Client, capture: Path, seconds: float | None, folder: Path) -> tuple[Scene, Operation]:
    capture_name = capture.parent.name if capture.name == "images" else capture.stem
    name = "sample, trained here" if capture == SAMPLE_PHOTOS else capture_name  # the package's "sample" is in meters
    posted = client.create_scene(capture, name=name, options=SceneOptions(time_budget_s=seconds))
    typer.echo(f"posted {capture}: operation {posted.id}, scene {posted.scene_id}")
    tell_progress = ProgressLines()
    for operation in client.watch(posted.id):
        tell_progress(operation)
    if operation.state != "SUCCEEDED":
        typer.echo(f"the job ended as {operation.state}: {operation.error}\nsee {folder}/service.log", err=True)
        raise typer.Exit(1)
    return client.scene(operation.scene_id), operation


def _ask(client: Client, scene_id: str, text: str) -> Answer:
    request = QueryRequest(scene_id, (text,), outputs=frozenset({"objects"}), max_matches=-1)
    (answer,) = client.ask(request)
    return answer


def _click_and_name(client: Client, scene_id: str, view: str) -> PickedObject | None:
    """Clicks on an object without a name and names it `_NAME`; returns it before that, None without."""
    ids = client.object_map(scene_id, view)
    objects = {obj.id: obj for obj in client.objects(scene_id)}
    target = object_to_name(ids, objects)
    if target is None:
        return None
    inner = cv2.distanceTransform((ids == target).astype(np.uint8), cv2.DIST_L2, 5)
    row, column = np.unravel_index(int(inner.argmax()), inner.shape)
    picked = client.pick(scene_id, view, pixel=(float(column) + 0.5, float(row) + 0.5))
    client.name_objects(scene_id, picked.object.id, _NAME, looked_at=picked.version)
    return picked


def object_to_name(ids: NDArray[np.uint16], objects: Mapping[int, SceneObject]) -> int | None:
    """Id of the largest object without a name, whole ones before cut ones; None without.

    Args:
        ids: uint16 [H, W], the object of each pixel of a view, 0 for none.
        objects: by id.
    """
    areas = dict(zip(*(numbers.tolist() for numbers in np.unique(ids, return_counts=True)), strict=True))
    cut = set(np.concatenate([ids[0], ids[-1], ids[:, 0], ids[:, -1]]).tolist())
    unnamed = [number for number in areas if number and not objects[number].name and objects[number].kind != "surface"]
    return min(unnamed, key=lambda number: (number in cut, -areas[number]), default=None)
