"""Scenes as each earlier release wrote them open, answer, are edited and undone.

`earlier_schemas` has one folder for each schema, written by the code of that time: a mug and a ball on whose surfaces
48 Gaussians lie, and, without a name, a shelf; from schema 4 on with things, from 6 on with a part of the mug.
"""

from __future__ import annotations

import zipfile
from pathlib import Path

import numpy as np
import pytest

from fastsplat.service.application.service import SceneService
from fastsplat.service.scene.scene_files import read_scene, write_scene
from fastsplat.service.scene.scene_manifest import SCHEMA
from fastsplat_client import Client
from fastsplat_contract.poses import Pose, Quaternion, Vector3
from fastsplat_contract.scenes import Edit
from tests.scenes import store_scene

_FOLDERS = Path(__file__).parents[1] / "scene" / "earlier_schemas"
_UP = Pose(Vector3(0.0, 0.0, 1.0), Quaternion(0.0, 0.0, 0.0, 1.0))


def artefact_of(schema: int, folder: Path) -> Path:
    """The scene's folder as the release of a schema wrote it; of the newest, as this one does."""
    known = folder / f"schema {min(schema, SCHEMA - 1)}"
    with zipfile.ZipFile(_FOLDERS / f"schema_{min(schema, SCHEMA - 1)}.zip") as archive:
        archive.extractall(known)
    if schema < SCHEMA:
        return known
    write_scene(read_scene(known), folder / "newest")
    return folder / "newest"


def test_there_is_a_folder_of_each_earlier_schema() -> None:
    known = {path.name for path in _FOLDERS.iterdir()}
    assert known == {f"schema_{schema}.zip" for schema in range(1, SCHEMA)}


@pytest.mark.parametrize("schema", range(1, SCHEMA + 1))
def test_a_scene_of_each_schema_opens_and_is_edited_and_undone(
    schema: int, service: SceneService, client: Client, tmp_path: Path
) -> None:
    folder = artefact_of(schema, tmp_path)
    assert f'"schema": {schema},' in (folder / "scene.json").read_text()
    scene = store_scene(service._store, read_scene(folder), artefact=folder)

    def state() -> tuple[object, ...]:
        answers = [client.query(scene, text, outputs=["mask3d", "objects"])[0] for text in ("mug", "sphere")]
        plain = [(each.outcome, each.sentence, each.things, each.mask3d, each.objects) for each in answers]
        return plain, list(client.things(scene, parts=True)), client.thing_map(scene, "0.jpg").tobytes()

    before = state()
    first = client.scene(scene).version
    mug, ball = (client.query(scene, text, outputs=["objects"])[0] for text in ("mug", "sphere"))
    assert mug.outcome in ("here", "probably_here") and ball.outcome in ("here", "probably_here")
    assert mug.objects and ball.objects and client.mask3d(scene, "mug").sum() == 48
    assert (np.unique(client.thing_map(scene, "0.jpg")) > 0).sum() >= 2
    assert client.query(scene, "elephant")[0].is_absent
    things = ball.things

    def heights() -> list[float]:
        boxes = (each.box for each in client.things(scene) if each.id in things)
        return [box.center.position.z for box in boxes if box is not None]

    low = heights()
    client.edit_scene(scene, [Edit("move", things=things, transform=_UP)])
    assert heights() == pytest.approx([height + 1 for height in low], abs=1e-4)
    moved = client.scene(scene).version
    client.edit_scene(scene, [Edit("name", things=things, name="violin")], looked_at=moved)
    assert client.query(scene, "violin")[0].things == things
    client.undo_edit(scene)
    assert client.query(scene, "violin")[0].is_absent and client.query(scene, "ball")[0].things == things
    client.undo_edit(scene)
    assert client.scene(scene).version == first and state() == before
    client.redo_edit(scene)
    assert heights() == pytest.approx([height + 1 for height in low], abs=1e-4)
