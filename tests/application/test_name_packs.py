"""Names of one project in another: a pack tells the same there, of the same model alone, and whole or not at all."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from fastsplat.service.application.admin.name_packs import checked_names
from fastsplat.service.application.service import SceneService, open_service
from fastsplat.service.perception.appearance import SIZE
from fastsplat.service.perception.settings import PerceptionSettings
from fastsplat.service.perception.text.open_text_encoder import open_text_encoder
from fastsplat.service.query.settings import QuerySettings
from fastsplat.service.query.things.names_by_looks import KnownThing, described
from fastsplat.service.scene.label_evidence import UNIT, evidence_of
from fastsplat.service.scene.types import Scene, Thing, Things
from fastsplat.service.settings import CallSettings, Settings
from fastsplat_contract.camera import Camera, PosedCamera
from fastsplat_contract.errors import ConflictError, InvalidInputError, LimitExceededError, ModelUnavailableError
from fastsplat_contract.json_codec import from_json, to_json
from fastsplat_contract.known_names import KindCheck, NamePack, PackedName
from fastsplat_contract.scenes import Edit
from fastsplat_contract.thing_messages import NameSuggestion
from tests.api.made_scene import ENCODER, write_words
from tests.scenes import finish_job, labelled_scene, queued_job

_EACH = 20
_LICENSE = "CC0-1.0"


def _looks(place: int, rest: float = 0.0) -> bytes:
    row = np.zeros(SIZE)
    row[[place, SIZE - 1]] = np.sqrt(1 - rest**2), rest
    return row.astype(np.float16).tobytes()


def _settings(folder: Path, detector: bytes) -> Settings:
    """Of a server whose detector is that file."""
    models = folder / "models"
    write_words(models)
    (models / "picodet_416").mkdir()
    (models / "picodet_416" / "picodet_416.onnx").write_bytes(detector)
    return Settings(
        data_dir=folder,
        models=models,
        perception=PerceptionSettings(text_encoder=ENCODER),
        query=QuerySettings(backend="reference"),
        calls=CallSettings(max_known_names=6),
    )


@pytest.fixture
def service(tmp_path: Path) -> Iterator[SceneService]:
    with open_service(_settings(tmp_path, b"a detector")) as opened:
        opened.admin.projects.create("other")
        yield opened


def _add(service: SceneService, project: str, *places: int, wide: float = 0.1) -> str:
    """Store a scene of things without names that look like the given places, in meters; returns its id."""
    rng = np.random.default_rng(5)
    owner = np.repeat(np.arange(len(places)), _EACH)
    means = np.array([0.0, 0.0, 4.0]) + np.outer(owner - 1.0, [1, 0, 0]) + wide * rng.normal(size=(len(owner), 3))
    table = tuple(Thing(n, appearance=_looks(place, 0.2), picture=b"p") for n, place in enumerate(places, start=1))
    rows = np.arange(len(owner))
    camera = PosedCamera(Camera(32, 24, 30.0, 30.0, 16.0, 12.0), np.eye(4), "front.png")
    scene: Scene = labelled_scene(
        means,
        np.zeros(len(owner), int),
        (),
        encoder=open_text_encoder(ENCODER, service._settings.models),
        templates=QuerySettings().templates,
        cameras=[camera],
        things=Things(table, evidence_of(rows, owner + 1, np.full(len(owner), UNIT), len(owner))),
    )
    job = replace(queued_job(), project=project)
    store = service.in_project(project)._store
    store.scenes.create(job)
    finish_job(store, job.operation_id, replace(scene, scale="METRIC"))
    return job.scene_id


def _suggested(service: SceneService, scene_id: str) -> dict[int, tuple[NameSuggestion, ...]]:
    return {thing.id: thing.suggestions for thing in service.answers.list_things(scene_id).things}


@pytest.fixture
def taught(service: SceneService) -> NamePack:
    """What a project knows that named three things of one scene."""
    scene_id = _add(service, "default", 3, 7, 9)
    names = [Edit("name", things=(n,), name=name) for n, name in enumerate(("mug", "elephant", "carrot"), start=1)]
    service.versions.edit(scene_id, names)
    return service.known_names.export_pack(_LICENSE)


def test_a_pack_suggests_in_another_project_what_it_would_in_its_own(service: SceneService, taught: NamePack) -> None:
    other = service.in_project("other")
    own, theirs = _add(service, "default", 7, 40), _add(service, "other", 7, 40)
    _add(service, "other", 41)
    assert _suggested(other, theirs) == {1: (), 2: ()}
    file = to_json(taught)
    assert b"fastsplat" not in file and taught.license == _LICENSE
    assert sorted(each.name for each in taught.names) == ["carrot", "elephant", "mug"]
    added = other.known_names.add_pack(from_json(NamePack, file))
    ((at_home,), (here,)) = _suggested(service, own)[1], _suggested(other, theirs)[1]
    assert (here.name, here.probability) == (at_home.name, at_home.probability) and here.name == "elephant"
    assert here.scene_id == "" and [each.source for each in here.said_by] == ["pack"]
    assert _suggested(other, theirs)[2] == ()
    (listed,) = other.known_names.list().packs
    assert listed == added and (listed.names, listed.license, listed.model) == (3, _LICENSE, "picodet_416")
    assert service.known_names.list().packs == ()  # no other project has it
    # What was learnt elsewhere is not passed on as one's own.
    with pytest.raises(InvalidInputError):
        other.known_names.export_pack(_LICENSE)
    other.known_names.forget(listed.id)
    assert _suggested(other, theirs) == {1: (), 2: ()} and other.known_names.list().packs == ()


def test_a_pack_of_another_model_is_refused_and_both_are_named(taught: NamePack, tmp_path: Path) -> None:
    with open_service(_settings(tmp_path / "elsewhere", b"another detector")) as elsewhere:
        scene_id = _add(elsewhere, "default", 3)
        elsewhere.versions.edit(scene_id, [Edit("name", things=(1,), name="mug")])
        theirs = elsewhere.known_names.export_pack(_LICENSE)
        assert theirs.digest != taught.digest and theirs.model == taught.model
        for asking in (elsewhere.known_names.add_pack, elsewhere.known_names.check):
            with pytest.raises(ConflictError) as raised:
                asking(taught)
            assert raised.value.field == "pack.digest"
            assert taught.digest[:12] in str(raised.value) and theirs.digest[:12] in str(raised.value)
        assert elsewhere.known_names.list().packs == ()


def _changed(pack: NamePack, appearance: bytes) -> NamePack:
    return pack._replace(names=(*pack.names[:2], PackedName("mug", appearance)))


_SPOILED: dict[str, Callable[[bytes], bytes]] = {
    "empty": lambda _: b"",
    "half": lambda looks: looks[: len(looks) // 2],
    "long": lambda looks: looks + bytes(4),
    "nan": lambda looks: np.float16("nan").tobytes() + looks[2:],
    "infinite": lambda looks: np.float16("inf").tobytes() + looks[2:],
    "zero": lambda looks: bytes(len(looks)),
    "loud": lambda looks: (3 * np.frombuffer(looks, np.float16)).astype(np.float16).tobytes(),
    "size": lambda looks: looks[: 2 * SIZE] + np.array([0.1, -0.1, 0.1], np.float16).tobytes(),
    "size that is none": lambda looks: looks[: 2 * SIZE] + np.array([0.1, np.nan, 0.1], np.float16).tobytes(),
}


@pytest.mark.parametrize("spoiled", _SPOILED)
def test_a_pack_with_one_bad_row_is_refused_whole(service: SceneService, taught: NamePack, spoiled: str) -> None:
    other = service.in_project("other").known_names
    with pytest.raises(InvalidInputError) as raised:
        other.add_pack(_changed(taught, _SPOILED[spoiled](taught.names[2].appearance)))
    assert raised.value.field == "pack.names[2].appearance" and other.list().packs == ()
    other.add_pack(_changed(taught, taught.names[2].appearance[: 2 * SIZE]))  # a size may be unknown


@pytest.mark.parametrize("name", ["\n", "a\x1b[2J", "\u202eabc", "\0"])
def test_a_pack_with_a_name_that_is_none_is_refused(service: SceneService, taught: NamePack, name: str) -> None:
    with pytest.raises(InvalidInputError):
        service.known_names.add_pack(taught._replace(names=(PackedName(name, taught.names[0].appearance),)))
    assert service.known_names.list().packs == ()


def test_a_part_of_a_file_is_no_pack(taught: NamePack) -> None:
    file = to_json(taught)
    plain = json.loads(file)
    for part in (b"", file[: len(file) // 2], file[:-1], b"[]", json.dumps({**plain, "names": []}).encode()):
        with pytest.raises(InvalidInputError):
            from_json(NamePack, part)
    for field in ("license", "model", "digest", "names"):
        with pytest.raises(InvalidInputError):
            from_json(NamePack, json.dumps({name: value for name, value in plain.items() if name != field}))
    with pytest.raises(InvalidInputError):
        from_json(NamePack, json.dumps({**plain, "license": ""}))


def test_packs_have_no_more_names_than_a_project_remembers(service: SceneService, taught: NamePack) -> None:
    other = service.in_project("other").known_names
    packs = [other.add_pack(taught) for _ in range(2)]
    with pytest.raises(LimitExceededError) as raised:
        other.add_pack(taught)
    assert raised.value.limit == "6" and len(other.list().packs) == 2
    other.forget(packs[0].id)
    other.add_pack(taught)
    other.forget_all()
    assert other.list().packs == ()


def _known(scene: str, name: str, place: int, wide: float = 0.1) -> KnownThing:
    things = Things((Thing(1, appearance=_looks(place)),), evidence_of(*(np.zeros(0, np.int64),) * 3, 1))
    return KnownThing(scene, name, described(things, {1: np.full(3, wide)})[1])


def test_a_check_leaves_each_scene_out_and_counts_what_the_others_tell() -> None:
    known = [
        *(_known("a", name, place) for name, place in (("mug", 1), ("book", 2), ("lamp", 3))),
        *(_known("b", name, place) for name, place in (("Mug", 1), ("book", 4), ("jar", 2))),
    ]
    told = checked_names(known)
    assert told.kinds == (
        KindCheck("book", 2, 2, 1, 0),  # the jar of b looks like the book of a
        KindCheck("jar", 1, 0, 1, 0),
        KindCheck("lamp", 1, 0, 0, 0),
        KindCheck("mug", 2, 2, 2, 2),
    )
    assert (told.borne, told.suggested, told.right) == (4, 4, 2)
    # Of one scene alone nothing can be told; what a pack knows is told in every scene.
    assert checked_names(known[:3]).borne == checked_names(known[:3]).suggested == 0
    pack = replace(_known("", "lamp", 3), source="pack")
    assert checked_names([*known[:3], pack]).right == 1 and checked_names([]).kinds == ()


def test_a_pack_is_checked_before_it_is_added(service: SceneService, taught: NamePack) -> None:
    other = service.in_project("other")
    scene_id = _add(service, "other", 7, 9)
    other.versions.edit(scene_id, [Edit("name", things=(n,), name=name) for n, name in ((1, "elephant"), (2, "mug"))])
    assert other.known_names.check().borne == 0
    told = other.known_names.check(taught)
    assert {each.name: (each.borne, each.suggested, each.right) for each in told.kinds} == {
        "carrot": (0, 1, 0),
        "elephant": (1, 1, 1),
        "mug": (1, 0, 0),
    }
    assert other.known_names.list().packs == ()
    other.known_names.add_pack(taught)
    assert other.known_names.check() == told


def test_a_server_without_such_a_detector_says_so(taught: NamePack, tmp_path: Path) -> None:
    settings = _settings(tmp_path / "elsewhere", b"")
    (settings.models / "picodet_416" / "picodet_416.onnx").unlink()
    with open_service(settings) as elsewhere, pytest.raises(ModelUnavailableError):
        elsewhere.known_names.add_pack(taught)
