"""A damaged row costs no other scene anything: it is a typed error or left out, and the doctor finds it."""

from __future__ import annotations

import shutil
import sqlite3
from collections.abc import Callable, Iterator
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path

import pytest
from PIL import Image

from fastsplat.api.errors import refusal_of
from fastsplat.service.application.editing.version_rows import version_of
from fastsplat.service.application.jobs.stored import operation_of, scene_of
from fastsplat.service.application.service import SceneService, open_service
from fastsplat.service.perception.perception_settings import PerceptionSettings
from fastsplat.service.perception.text.text_encoders import open_text_encoder
from fastsplat.service.settings import Settings
from fastsplat.service.store.care.checkup import check_database
from fastsplat.service.store.care.row_checkup import check_rows
from fastsplat_contract.messages.exports import ExportRequest
from fastsplat_contract.messages.queries import QueryRequest
from fastsplat_contract.messages.scenes import Color, Edit
from tests.api.made_scene import ENCODER, made_scene, write_words
from tests.scenes import add_photos, store_scene

_EDIT = Edit("recolor", "mug", color=Color(1.0, 0.0, 0.0))
_KEY = "insert into api_keys (id, name, role, hash, created_at, operation_id, project, scene_id) values "
_KEY += f"('k', 'k', 'reader', '{'0' * 64}', 2e9,"

DAMAGES = {
    "state": "update scenes set state='EVIL' where {S}",
    "no version": "update scenes set version='' where {S}",
    "version elsewhere": "update scenes set version='../x' where {S}",
    "version without a row": "update scenes set version='dddd' where {S}",
    "dictionary no JSON": "update scenes set dictionary='{{' where {S}",
    "dictionary no list": "update scenes set dictionary='7' where {S}",
    "dictionary of others": "update scenes set dictionary='[{{\"a\": 1}}]' where {S}",
    "cameras": "update scenes set cameras='[1,2]' where {S}",
    "cameras of others": "update scenes set cameras='[{{}}]' where {S}",
    "quality": "update scenes set quality='\"x\"' where {S}",
    "quality a blob": "update scenes set quality=X'ff7b' where {S}",
    "scaling": "update scenes set scaling='[]' where {S}",
    "scaling of others": "update scenes set scaling='{{}}' where {S}",
    "alignment": "update scenes set alignment='{{\"frame\": 1}}' where {S}",
    "scale": "update scenes set scale='HUGE' where {S}",
    "gaussians": "update scenes set gaussians='many' where {S}",
    "time no number": "update scenes set created_at='abc' where {S}",
    "time too late": "update scenes set created_at=1e300 where {S}",
    "time before all": "update scenes set created_at=-1e300 where {S}",
    "project": "update scenes set project='ghost' where {S}",
    "stages no list": "update operations set stages='7' where {O}",
    "stages of others": "update operations set stages='[{{}}]' where {O}",
    "error": "update operations set error='[]' where {O}",
    "error of others": "update operations set error='{{\"a\": 1}}' where {O}",
    "options no object": "update operations set options='[]' where {O}",
    "options no JSON": "update operations set options='{{\"retries\": ' where {O}",
    "retries no number": "update operations set retries='x' where {O}",
    "kind": "update operations set kind='' where {O}",
    "models": "update operations set models='[]' where {O}",
    "attempt's time": "update attempts set began_at='abc' where operation_id in (select id from operations where {O})",
    "attempt's reason": "update attempts set why='WHAT' where operation_id in (select id from operations where {O})",
    "operation's state": "update operations set state='WHAT' where {O}",
    "operation's time": "update operations set updated_at='abc' where {O}",
    "no operation": "delete from operations where {O}",
    "no versions but the first": "delete from scene_versions where scene_id='{id}' and parent!=''",
    "versions' edits": "update scene_versions set edits='7' where scene_id='{id}'",
    "versions' edits of others": "update scene_versions set edits='[{{\"a\": 1}}]' where scene_id='{id}'",
    "versions' time": "update scene_versions set created_at='abc' where scene_id='{id}'",
    "versions' parent": "update scene_versions set parent='ghost' where scene_id='{id}' and parent!=''",
    "photos": "insert or replace into scene_photos values ('{id}', '[1]')",
    "versions' author": "update scene_versions set author='ghost' where scene_id='{id}' and parent!=''",
    "photos of no scene": "insert into scene_photos values ('ghost', '[]')",
    "names of no scene": "insert into known_names (id, version, scene_id, object_id, name, named_at, appearance, "
    "picture, said, tags) values ('n', 'v', 'ghost', 1, 'mug', 1.0, '', '', '[]', '[]')",
    "job of no scene": "update operations set scene_id='ghost', state='QUEUED' where {O}",
    "key of no operation": f"{_KEY} 'ghost', 'default', '')",
    "key of no project": f"{_KEY} null, 'ghost', '')",
    "key of no scene": f"{_KEY} null, 'default', 'ghost')",
    "no projects": "delete from projects",
    "no table": "drop table scene_photos",
    "key": "insert into api_keys (id, name, role, hash, created_at, project, scene_id) "
    "values ('k', 'k', 'wizard', 'x', 1.0, 'default', '')",
    "bytes": "insert or replace into quota_usage values ('{id}', -5)",
    "schema": "update alembic_version set version_num='zzz'",
}


@dataclass(frozen=True)
class Place:
    """A service with a scene that is edited and to be damaged, and one that is not."""

    service: SceneService
    settings: Settings
    scene: str
    operation: str
    intact: str
    saved: Path

    @property
    def database(self) -> Path:
        return self.settings.data_dir / "fastsplat.sqlite"


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Place]:
    folder = tmp_path_factory.mktemp("damaged")
    write_words(folder / "models")
    settings = Settings(
        data_dir=folder / "data", models=folder / "models", perception=PerceptionSettings(text_encoder=ENCODER)
    )
    with open_service(settings) as service:
        scene = made_scene(open_text_encoder(ENCODER, settings.models))
        ids = [store_scene(service._store, scene, name) for name in ("other", "damaged")]
        for scene_id in ids:
            add_photos(service._store, scene_id, [Image.new("RGB", (24, 18))] * 3)
        service.versions.edit(ids[1], [_EDIT])
        operation = service.get_scene(ids[1]).operation_id
        yield Place(service, settings, ids[1], operation, ids[0], folder / "saved.sqlite")


@pytest.fixture
def damage(place: Place) -> Iterator[Callable[[str], None]]:
    def do(statement: str) -> None:
        words = {"id": place.scene, "S": f"id='{place.scene}'", "O": f"id='{place.operation}'"}
        with closing(sqlite3.connect(place.database)) as connection:
            connection.execute("pragma foreign_keys=off")
            connection.execute(statement.format(**words))
            connection.commit()

    _copy(place.database, place.saved)
    folders = place.settings.data_dir / "scenes" / place.scene
    before = set(folders.iterdir())
    yield do
    _copy(place.saved, place.database)
    for folder in set(folders.iterdir()) - before:
        shutil.rmtree(folder)


def _copy(source: Path, target: Path) -> None:
    with closing(sqlite3.connect(source)) as reader, closing(sqlite3.connect(target)) as writer:
        reader.backup(writer)


def _calls(service: SceneService, scene: str, operation: str) -> dict[str, Callable[[], object]]:
    """What callers do, as one who does not know of the damage."""
    return {
        "list scenes": service.list_scenes,
        "get scene": lambda: service.get_scene(scene),
        "labels": lambda: service.list_labels(scene),
        "query": lambda: service.answers.query(QueryRequest(scene, ("mug",))).answers,
        "query all": lambda: service.answers.query(QueryRequest("", ("mug",))),
        "list operations": service.list_operations,
        "get operation": lambda: service.get_operation(operation),
        "cancel": lambda: service.cancel_operation(operation),
        "retry": lambda: service.retry_operation(operation),
        "objects": lambda: service.answers.list_objects(scene),
        "detections": lambda: service.answers.detections(scene),
        "photos": lambda: service.photos.all(scene),
        "photo": lambda: service.photos.path(scene, "front.png"),
        "photo verdicts": lambda: service.list_photo_verdicts(scene),
        "PLY": lambda: service.answers.scene_ply(scene),
        "SPZ": lambda: service.exports.file(ExportRequest(scene, "spz")),
        "versions": lambda: service.versions.all(scene),
        "edit": lambda: service.versions.edit(scene, [_EDIT]),
        "undo": lambda: service.versions.undo(scene),
        "keys": lambda: service.keys.list("operator"),
        "status": lambda: service.status("operator", ""),
        "known names": service.known_names.list,
        "waiting": lambda: service._store.jobs.in_turn(99),
        "over": lambda: service._store.jobs.over([operation]),
    }


@pytest.mark.parametrize("kind", DAMAGES)
def test_a_damaged_row_is_typed_or_left_out_and_the_doctor_finds_it(
    kind: str, place: Place, damage: Callable[[str], None]
) -> None:
    service = place.service
    damage(DAMAGES[kind])
    assert _problems(place), "the doctor finds nothing"
    untyped = {}
    for name, call in _calls(service, place.scene, place.operation).items():
        try:
            call()
        except Exception as error:
            if refusal_of(error, "r").reason == "INTERNAL":
                untyped[name] = error
    assert not untyped
    assert place.intact in {scene.id for scene in service.list_scenes().scenes}
    assert service.get_scene(place.intact).state == "READY"
    answers = service.answers.query(QueryRequest("", ("mug",))).answers
    assert place.intact in {answer.scene_id for answer in answers}
    scene_ids = {operation.scene_id for operation in service.list_operations().operations}
    assert place.intact in scene_ids


def _problems(place: Place) -> list[str]:
    problems = list(check_database(place.settings.data_dir, ""))
    if not problems:
        problems += check_rows(place.service._store, scene_of, operation_of, version_of, 1e9)
    return [problem.message for problem in problems]


def test_nothing_is_wrong_with_the_rows_of_an_edited_scene(place: Place) -> None:
    assert _problems(place) == []


def test_of_pages_of_one_none_ends_at_a_damaged_row(place: Place, damage: Callable[[str], None]) -> None:
    damage(DAMAGES["quality"])
    page = place.service.list_scenes(page_size=1)
    assert [scene.id for scene in page.scenes] == [place.intact]


def test_a_damaged_scene_can_be_deleted(place: Place, damage: Callable[[str], None]) -> None:
    service = place.service
    damage(DAMAGES["state"])
    damage(DAMAGES["stages no list"])
    doomed = place.settings.data_dir / "scenes" / place.scene
    doomed.rename(doomed.with_name("kept"))  # for the tests after this one
    service.delete_scene(place.scene)
    assert {scene.id for scene in service.list_scenes().scenes} == {place.intact}
    doomed.with_name("kept").rename(doomed)
