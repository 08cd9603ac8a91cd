"""`fastsplat scenes`: rename a scene."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Annotated

import typer

from fastsplat.service.settings import load_settings
from fastsplat.service.store.records import DEFAULT_PROJECT
from fastsplat_contract.scenes import SceneUpdate

if TYPE_CHECKING:
    from fastsplat.service.application.service import SceneService

scenes_app = typer.Typer(name="scenes", help="Scenes: rename them.", no_args_is_help=True)

SceneId = Annotated[str, typer.Argument(help="The scene's id.")]
Project = Annotated[str, typer.Option(help="The project whose scene it is.")]


@scenes_app.command()
def rename(
    scene: SceneId,
    name: Annotated[str, typer.Argument(help="Its new name; it need not be unique.")],
    project: Project = DEFAULT_PROJECT,
) -> None:
    """Give a scene another name."""
    with _service(project) as service:
        renamed = service.update_scene(scene, SceneUpdate(name))
    typer.echo(f"scene {renamed.id} is called {renamed.name!r}", err=True)


@contextmanager
def _service(project: str) -> Iterator[SceneService]:
    from fastsplat.service.application.service import open_service  # loads what answers questions

    with open_service(load_settings()) as service:
        yield service.in_project(project)
