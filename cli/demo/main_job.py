"""The main job on one capture, through the wire protocols alone: a service is started, the capture posted, its training
watched, questions asked, and what came of it written into a folder."""

from __future__ import annotations

import time
from collections.abc import Sequence
from pathlib import Path

import typer
from rich.console import Console

from fastsplat.cli.demo.name_by_click import NAME, click_and_name
from fastsplat.cli.demo.questions import SAMPLE_QUESTIONS, questions_for
from fastsplat.cli.demo.report import print_report, report_of, save_pictures, write_report
from fastsplat.cli.demo.service_process import running_service
from fastsplat.service.settings import Settings
from fastsplat_client import Client
from fastsplat_contract.errors import ResourceError
from fastsplat_contract.jobs.operations import Operation, SceneOptions
from fastsplat_contract.messages.queries import Answer, QueryRequest
from fastsplat_contract.messages.scenes import Scene

SAMPLE_PHOTOS = Path(__file__).parent / "photos"
"""The sample capture: 26 photos of a table with things on it."""
_FIGURES = ("loss", "psnr", "iterations_per_second")


def run_main_job(
    folder: Path, settings: Settings, *, photos: Path | None, ask: Sequence[str], seconds: float | None
) -> None:
    """Runs the main job from photos to answers into the empty `folder`: report.json, pictures, PLY files, `service`.

    Without `photos` the sample's are taken, without `ask` the sample's questions, or some of the scene's names.

    Raises:
        FastSplatError: a port is taken, the service does not start, or what it answers.
        typer.Exit: the job failed; says why.
    """
    console = Console()
    started = time.monotonic()
    ports = {"http_port": settings.http_port, "grpc_port": settings.grpc_port}
    with (
        running_service(
            data_dir=folder / "service", models=settings.models.resolve(), log=folder / "service.log", **ports
        ) as key,
        Client(
            f"http://127.0.0.1:{settings.http_port}",
            key=key,
            grpc_target=f"127.0.0.1:{settings.grpc_port}",
            timeout_s=120.0,
        ) as client,
    ):
        scene, operation = _train(client, photos or SAMPLE_PHOTOS, seconds, console, folder)
        texts = ask or (questions_for(_labels(scene)) if photos else SAMPLE_QUESTIONS)
        answers = [_ask(client, scene.id, text) for text in texts]
        things, view = list(client.things(scene.id)), scene.cameras[len(scene.cameras) // 2].name
        (folder / "things.png").write_bytes(client.picture(scene.id, "things", view))
        if (named := click_and_name(client, scene.id, view)) is not None:
            before = f'"{named.thing.name}"' if named.thing.name else "without a name"
            console.print(f'a click in {view} finds thing {named.thing.id}, {before}; a person names it "{NAME}"')
            answers.append(_ask(client, scene.id, NAME))
        report = report_of(scene, operation, things, answers)
        write_report(report, folder)
        save_pictures(client, scene, answers, view, folder)
        print_report(report, console)
    console.print(f"{time.monotonic() - started:.0f} s in all, downloads aside; everything is in {folder}/")


def _train(
    client: Client, capture: Path, seconds: float | None, console: Console, folder: Path
) -> tuple[Scene, Operation]:
    own = capture.parent.name if capture.name == "images" else capture.stem
    name = "sample, trained here" if capture == SAMPLE_PHOTOS else own  # the package's "sample" is in meters
    posted = client.create_scene(capture, name=name, options=SceneOptions(time_budget_s=seconds))
    console.print(f"posted {capture}: operation {posted.id}, scene {posted.scene_id}")
    show = _Progress(console)
    for operation in client.watch(posted.id):
        show(operation)
    if operation.state != "SUCCEEDED":
        typer.echo(f"the job ended as {operation.state}: {operation.error}\nsee {folder}/service.log", err=True)
        raise typer.Exit(1)
    return client.scene(operation.scene_id), operation


def _labels(scene: Scene) -> Sequence[str]:
    return [row.label for row in sorted(scene.dictionary, key=lambda row: -row.gaussian_count)]


def _ask(client: Client, scene_id: str, text: str) -> Answer:
    """The answer, checked to be the same over REST and over gRPC."""
    request = QueryRequest(scene_id, (text,), outputs=frozenset({"objects"}), max_matches=-1)
    (rest,), (grpc,) = client.ask(request), client.ask(request, protocol="gRPC")
    if rest != grpc:
        raise ResourceError(f"REST and gRPC disagree:\n{rest}\n{grpc}")
    return rest


class _Progress:
    """One line per stage, rewritten on a terminal, appended where output is a file."""

    def __init__(self, console: Console) -> None:
        self._console = console
        self._last = ""

    def __call__(self, operation: Operation) -> None:
        if not operation.stages:
            return
        stage = operation.stages[-1]
        figures = ", ".join(f"{name} {stage.metrics[name]:.4g}" for name in _FIGURES if name in stage.metrics)
        # One line for each tenth of a stage: messages change several times a second.
        step = f"{stage.stage} {int(stage.fraction * 10)}"
        if step != self._last:
            self._last = step
            line = f"{stage.stage:<11}{stage.fraction:>5.0%} {stage.seconds:>6.1f} s  {stage.message}"
            self._console.print(f"{line}  {figures}".rstrip(), soft_wrap=True, highlight=False)
