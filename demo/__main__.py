"""`python -m demo`: start the service, post a capture, watch its training, ask questions, write the answers."""

from __future__ import annotations

import argparse
import os
import shlex
import shutil
import subprocess
import sys
import time
from collections.abc import Sequence
from pathlib import Path

from rich.console import Console

from demo.name_by_click import NAME, click_and_name
from demo.questions import SAMPLE_QUESTIONS, questions_for
from demo.run_report import print_report, report_of, save_pictures, write_report
from demo.service_process import running_service
from fastsplat_client import Client
from fastsplat_contract.errors import FastSplatError
from fastsplat_contract.operations import Operation, SceneOptions
from fastsplat_contract.queries import Answer, QueryRequest
from fastsplat_contract.scenes import Scene

_ROOT = Path(__file__).parent.parent
_OUTPUT = Path("demo-output")
"""What `make look` serves."""
_SAMPLE = _ROOT / "demo" / "sample" / "images"
_FIGURES = ("loss", "psnr", "iterations_per_second", "seconds_left")


def main() -> None:
    """Run the demonstration once."""
    options = _options()
    console = Console()
    output: Path = options.output
    shutil.rmtree(output, ignore_errors=True)
    output.mkdir(parents=True)
    models = _models(Path(os.environ.get("FASTSPLAT_MODELS") or _ROOT / ".models").resolve(), _ROOT / ".models")
    started = time.monotonic()
    ports = {"http_port": options.http_port, "grpc_port": options.grpc_port}
    with (
        running_service(data_dir=output / "service", models=models, log=output / "service.log", **ports) as key,
        Client(
            f"http://127.0.0.1:{options.http_port}",
            key=key,
            grpc_target=f"127.0.0.1:{options.grpc_port}",
            timeout_s=120.0,
        ) as client,
    ):
        try:
            _run(client, options, console, output)
        except FastSplatError as error:
            raise SystemExit(f"{error.reason}: {error.message} {error.details()}") from error
    console.print(f"{time.monotonic() - started:.0f} s in all, downloads aside; everything is in {output}/")
    console.print(f"{how_to_look(output)}    then the scene is at http://localhost:8000/", soft_wrap=True)


def _models(folder: Path, own: Path) -> Path:
    """A folder with the default models: `folder`, or a copy in `own` where that is marked read-only and lacks some."""

    def pulled(into: Path) -> bool:
        command = [str(Path(sys.executable).parent / "fastsplat"), "models", "pull"]
        return subprocess.run(command, env={**os.environ, "FASTSPLAT_MODELS": str(into)}).returncode == 0

    if pulled(folder):
        return folder
    if folder == own or not folder.is_dir() or folder.stat().st_mode & 0o222:
        raise SystemExit("the models could not be fetched, see above")
    print(
        f"{folder} is left as it is; its models are copied to {own}, and what is missing is fetched there", flush=True
    )
    for path in folder.rglob("*"):
        copy = own / path.relative_to(folder)
        if path.is_file() and not copy.is_file():
            copy.parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(path, copy)
    if not pulled(own):
        raise SystemExit("the models could not be fetched, see above")
    return own


def how_to_look(output: Path) -> str:
    """The command that serves the page with what was trained into `output`."""
    if output == _OUTPUT:
        return "make look"
    program = Path(sys.executable).parent / "fastsplat"
    return f"FASTSPLAT_DATA_DIR={shlex.quote(str(output / 'service'))} {program} serve --no-auth"


def _run(client: Client, options: argparse.Namespace, console: Console, output: Path) -> None:
    capture: Path = options.photos or _SAMPLE
    scene_options = SceneOptions(time_budget_s=options.train_seconds)
    name = capture.parent.name if capture.name == "images" else capture.stem
    posted = client.create_scene(capture, name=name, options=scene_options)
    console.print(f"posted {capture}: operation {posted.id}, scene {posted.scene_id}")
    show = _Progress(console)
    for operation in client.watch(posted.id):
        show(operation)
    if operation.state != "SUCCEEDED":
        raise SystemExit(f"the job ended as {operation.state}: {operation.error}\nsee {output}/service.log")
    scene = client.scene(operation.scene_id)
    texts = options.ask or (questions_for(_labels(scene)) if options.photos else SAMPLE_QUESTIONS)
    answers = [_ask(client, scene.id, text) for text in texts]
    things, view = list(client.things(scene.id)), scene.cameras[len(scene.cameras) // 2].name
    (output / "things.png").write_bytes(client.picture(scene.id, "things", view))
    if (named := click_and_name(client, scene.id, view)) is not None:
        before = f'"{named.thing.name}"' if named.thing.name else "without a name"
        console.print(f'a click in {view} finds thing {named.thing.id}, {before}; a person names it "{NAME}"')
        answers.append(_ask(client, scene.id, NAME))
    report = report_of(scene, operation, things, answers)
    write_report(report, output)
    save_pictures(client, scene, answers, view, output)
    print_report(report, console)


def _labels(scene: Scene) -> Sequence[str]:
    return [row.label for row in sorted(scene.dictionary, key=lambda row: -row.gaussian_count)]


def _ask(client: Client, scene_id: str, text: str) -> Answer:
    """The answer, checked to be the same over REST and over gRPC."""
    request = QueryRequest(scene_id, (text,), outputs=frozenset({"objects"}), max_matches=-1)
    (rest,), (grpc,) = client.ask(request), client.ask(request, protocol="gRPC")
    if rest != grpc:
        raise SystemExit(f"REST and gRPC disagree:\n{rest}\n{grpc}")
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


def _options() -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="python -m demo", description=__doc__)
    parser.add_argument("--photos", type=Path, help="a folder of photos, a zip or tar, or a video; default: the sample")
    parser.add_argument("--ask", action="append", help="a question; may be given several times")
    parser.add_argument("--output", type=Path, default=_OUTPUT, help="emptied first; default: demo-output")
    parser.add_argument(
        "--train-seconds", type=float, help="time budget of all that comes after the capture; default: the server's"
    )
    parser.add_argument("--http-port", type=int, default=8000)
    parser.add_argument("--grpc-port", type=int, default=8001)
    options = parser.parse_args()
    if options.photos and not options.photos.exists():
        parser.error(f"--photos: {options.photos} does not exist")
    return options


if __name__ == "__main__":
    main()
