"""Names that people gave: known in all scenes of their project and nowhere else, until they are taken back."""

from __future__ import annotations

import pickle
import subprocess
import sys
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import get_args

import numpy as np
import pytest
from sqlalchemy import func, select

from fastsplat.service.application.service import SceneService, open_service
from fastsplat.service.perception.perception_settings import PerceptionSettings
from fastsplat.service.perception.text.text_encoders import open_text_encoder
from fastsplat.service.query.query_settings import QuerySettings
from fastsplat.service.scene.artefact.scene import Object, Objects
from fastsplat.service.scene.artefact.scene_files import read_scene
from fastsplat.service.scene.objects.label_evidence import evidence_of
from fastsplat.service.settings import CallSettings, Settings
from fastsplat.service.store.repositories.name_repository import KnownNameRecord, KnownNameRepository
from fastsplat.service.store.repositories.scene_repository import order_job
from fastsplat.service.store.rows.schema import known_names
from fastsplat.workers.job.claimed_job import ClaimedJob
from fastsplat.workers.job.protocol import Job
from fastsplat.workers.job.results import finish_stage, start_stage
from fastsplat.workers.kinds.job_kinds import KINDS
from fastsplat.workers.kinds.naming import write_renamed
from fastsplat_contract.codec.json_codec import to_plain
from fastsplat_contract.errors import InvalidInputError, NotFoundError
from fastsplat_contract.geometry.camera import Camera, PosedCamera
from fastsplat_contract.geometry.places import Alignment, KnownLength, Place
from fastsplat_contract.geometry.poses import Pose, Quaternion, Vector3
from fastsplat_contract.jobs.name_suggestions import SuggestedName
from fastsplat_contract.jobs.operations import OperationKind
from fastsplat_contract.messages.object_reads import ObjectRead
from fastsplat_contract.messages.objects import NameSuggestion, PickRequest
from fastsplat_contract.messages.queries import QueryRequest
from fastsplat_contract.messages.scenes import Color, Edit, EditAction, InsertSource
from tests.api.made_scene import ENCODER, write_words
from tests.scenes import labelled_scene, store_scene

_PER_OBJECT = 20
_WORDS = ("", "elephant", "submarine", "carrot")


def _looks(place: int) -> bytes:
    row = np.zeros(32, np.float16)
    row[place] = 1
    return row.tobytes()


@pytest.fixture
def service(tmp_path: Path, database_url: str) -> Iterator[SceneService]:
    write_words(tmp_path / "models")
    settings = Settings(
        data_dir=tmp_path,
        database_url=database_url,
        models=tmp_path / "models",
        perception=PerceptionSettings(text_encoder=ENCODER),
        query=QuerySettings(backend="reference"),
        calls=CallSettings(max_known_names=4, max_versions=3),
    )
    with open_service(settings) as opened:
        opened.admin.projects.create("a")
        opened.admin.projects.create("b")
        yield opened


@pytest.fixture
def add(service: SceneService, tmp_path: Path) -> Callable[..., str]:
    """Store a scene of three objects without names that look like the given places; returns its id."""

    def new_scene(*places: int, project: str = "default", tags: Sequence[str] = (), meters: float = 0.0) -> str:
        rng = np.random.default_rng(5)
        owner = np.repeat(np.arange(len(places)), _PER_OBJECT)
        wide = meters or 0.1
        means = np.array([0.0, 0.0, 4.0]) + np.outer(owner - 1.0, [1, 0, 0]) + wide * rng.normal(size=(len(owner), 3))
        table = tuple(
            Object(number + 1, appearance=_looks(place), picture=bytes([place])) for number, place in enumerate(places)
        )
        for number, tag in enumerate(tags):  # which are known by no look
            reads = (ObjectRead("tag", tag, 0.98, 4),) if tag else ()
            table = (*table[:number], Object(number + 1, reads=reads), *table[number + 1 :])
        membership = evidence_of(np.arange(len(owner)), owner + 1, np.full(len(owner), 4096), len(owner))
        camera = PosedCamera(Camera(48, 36, 40.0, 40.0, 24.0, 18.0), np.eye(4), "front.png")
        scene = labelled_scene(
            means,
            np.zeros(len(owner), int),
            (),
            encoder=open_text_encoder(ENCODER, tmp_path / "models"),
            templates=QuerySettings().templates,
            cameras=[camera],
            objects=Objects(table, membership),
        )
        scene = replace(scene, scale="METRIC" if meters else "ARBITRARY")
        return store_scene(service.in_project(project)._store, scene, project=project)

    return new_scene


def _name(service: SceneService, scene_id: str, object_id: int, name: str) -> None:
    service.versions.edit(
        scene_id, [Edit("name", object_ids=(object_id,), name=name)], looked_at=_current(service, scene_id)
    )


def _outcome(service: SceneService, scene_id: str, text: str) -> str:
    (answer,) = service.answers.query(QueryRequest(scene_id, (text,))).answers
    return answer.outcome


def _current(service: SceneService, scene_id: str) -> str:
    return service.versions.resolve(scene_id)


def _suggested(service: SceneService, scene_id: str) -> dict[int, tuple[NameSuggestion, ...]]:
    return {obj.id: obj.suggestions for obj in service.answers.list_objects(scene_id).objects}


def _known(service: SceneService) -> list[tuple[str, int, str, bytes]]:
    return [(known.scene_id, known.object_id, known.name, known.picture) for known in service.known_names.list().names]


def _rows(service: SceneService) -> int:
    with service._store.engine.connect() as connection:
        return connection.scalar(select(func.count()).select_from(known_names)) or 0


def test_a_name_is_suggested_for_what_looks_alike_in_other_scenes_old_and_new(
    service: SceneService, add: Callable[..., str]
) -> None:
    first, older = add(3, 7, 9), add(7, 3, 11)
    _name(service, first, 2, "mug")
    newer = add(20, 21, 7)
    assert _known(service) == [(first, 2, "mug", bytes([7]))]
    (guess,) = _suggested(service, older)[1]
    assert (guess.name, guess.scene_id) == ("mug", first) and 0.8 <= guess.probability <= 0.95
    assert _suggested(service, newer) == {1: (), 2: (), 3: (guess,)}
    assert all(obj.name == "" for obj in service.answers.list_objects(newer).objects)
    picked = service.answers.pick(PickRequest(newer, point=Vector3(1.0, 0.0, 4.0)))
    assert picked.object.suggestions == (guess,)
    assert not any(suggestion.scene_id for guesses in _suggested(service, first).values() for suggestion in guesses)


def test_of_two_names_for_the_same_looks_that_of_the_same_size_is_suggested(
    service: SceneService, add: Callable[..., str]
) -> None:
    for meters, name in ((0.01, "carrot"), (0.2, "elephant")):
        _name(service, add(7, 8, 9, meters=meters), 1, name)
    by_size = {meters: _suggested(service, add(7, 8, 9, meters=meters)) for meters in (0.011, 0.19)}
    assert [[guess.name for guess in by_size[meters][1]] for meters in (0.011, 0.19)] == [["carrot"], ["elephant"]]
    assert min(by_size[meters][1][0].probability for meters in by_size) > 0.9
    (unsized,) = _suggested(service, add(7, 8, 9))[1]  # whose unit nobody knows
    assert unsized.probability < min(by_size[meters][1][0].probability for meters in by_size)


def test_what_other_scenes_suggest_can_be_asked_for_until_it_is_taken_back(
    service: SceneService, add: Callable[..., str]
) -> None:
    first, second = add(3, 7, 9), add(7, 3, 11)
    _name(service, first, 2, "mug")
    (guess,) = _suggested(service, second)[1]
    (answer,) = service.answers.query(QueryRequest(second, ("the mug",), outputs=frozenset({"mask3d"}))).answers
    assert (answer.outcome, answer.object_ids, answer.probability) == ("probably_here", (1,), guess.probability)
    assert answer.mask3d is not None and np.unpackbits(np.frombuffer(answer.mask3d, np.uint8)).sum() == _PER_OBJECT
    everywhere = {reply.scene_id: reply.outcome for reply in service.answers.query(QueryRequest("", ("mug",))).answers}
    assert everywhere == {first: "here", second: "probably_here"}
    service.versions.undo(first)
    assert _outcome(service, second, "mug") == "cannot_say"


def test_names_are_read_once_until_any_process_changes_them(
    service: SceneService, add: Callable[..., str], monkeypatch: pytest.MonkeyPatch
) -> None:
    first, second = add(3, 7, 9), add(7, 3, 11)
    _name(service, first, 2, "mug")
    read: list[int] = []
    every = KnownNameRepository.all

    def counted(names: KnownNameRepository) -> Sequence[KnownNameRecord]:
        read.append(1)
        return every(names)

    monkeypatch.setattr(KnownNameRepository, "all", counted)
    for _ in range(2):
        assert _outcome(service, second, "mug") == "probably_here"
        assert len(_suggested(service, second)[1]) == 1
    assert len(read) == 1
    script = (
        "import pickle, sys\n"
        "from fastsplat.service.application.service import open_service\n"
        "settings, scene_id = pickle.load(sys.stdin.buffer)\n"
        "with open_service(settings) as service: service.versions.undo(scene_id)"
    )
    subprocess.run([sys.executable, "-c", script], input=pickle.dumps((service._context.settings, first)), check=True)
    assert _outcome(service, second, "mug") == "cannot_say" and len(read) == 2


def test_names_follow_undo_unname_rename_and_the_scenes_end(service: SceneService, add: Callable[..., str]) -> None:
    first, second = add(3, 7, 9), add(7, 3, 11)
    _name(service, first, 2, "mug")
    _name(service, first, 1, "moon")
    assert [name for _, _, name, _ in _known(service)] == ["moon", "mug"]
    _name(service, first, 2, "cup")
    assert _suggested(service, second)[1][0].name == "cup"
    service.versions.undo(first)
    assert _suggested(service, second)[1][0].name == "mug"
    service.versions.edit(first, [Edit("unname", object_ids=(2,))], looked_at=_current(service, first))
    assert [name for _, _, name, _ in _known(service)] == ["moon"] and _suggested(service, second)[1] == ()
    service.versions.undo(first)
    assert {name for _, _, name, _ in _known(service)} == {"moon", "mug"}
    service.delete_scene(first)
    assert _known(service) == [] and _rows(service) == 0
    assert set(_suggested(service, second).values()) == {()}


def test_what_is_forgotten_stays_so_until_it_is_named_again(service: SceneService, add: Callable[..., str]) -> None:
    first, second = add(3, 7, 9), add(7, 3, 11)
    _name(service, first, 2, "mug")
    _name(service, first, 1, "moon")
    newest, oldest = service.known_names.list().names
    service.known_names.forget(oldest.id)
    assert [known.id for known in service.known_names.list().names] == [newest.id]
    with pytest.raises(NotFoundError) as raised:
        service.known_names.forget(oldest.id)
    assert raised.value.field == "name_id"
    _name(service, first, 3, "violin")  # what a later version takes over is not what was forgotten
    assert {name for _, _, name, _ in _known(service)} == {"moon", "violin"}
    assert service.answers.list_objects(first).objects[1].name == "mug"
    _name(service, first, 2, "beaker")
    assert _suggested(service, second)[1][0].name == "beaker"
    service.known_names.forget("all")
    assert _known(service) == [] and _rows(service) == 0
    assert [obj.name for obj in service.answers.list_objects(first).objects] == ["moon", "beaker", "violin"]


def test_projects_never_see_each_others_names(service: SceneService, add: Callable[..., str]) -> None:
    mine, theirs = service.in_project("a"), service.in_project("b")
    in_a, in_b, in_default = add(3, 7, 9, project="a"), add(3, 7, 9, project="b"), add(3, 7, 9)
    _name(mine, in_a, 2, "volcano")
    (known,) = mine.known_names.list().names
    for project, scene_id in ((theirs, in_b), (service, in_default)):
        assert project.known_names.list().names == ()
        assert set(_suggested(project, scene_id).values()) == {()}
        with pytest.raises(NotFoundError):
            project.known_names.forget(known.id)
        project.known_names.forget("all")
    assert mine.known_names.list().names == (known,)
    assert _suggested(mine, add(1, 2, 7, project="a"))[3][0].name == "volcano"


def test_the_oldest_names_of_a_project_leave(service: SceneService, add: Callable[..., str]) -> None:
    scenes = [add(3, 7, 9), add(10, 11, 12)]
    for scene_id in scenes:
        for object_id in (1, 2, 3):
            _name(service, scene_id, object_id, _WORDS[object_id])
    known = _known(service)
    assert [row[:2] for row in known] == [(scenes[1], 3), (scenes[1], 2), (scenes[1], 1), (scenes[0], 3)]
    assert _rows(service) <= 4 * 3  # of the versions that are left
    page = service.known_names.list(page_size=3)
    rest = service.known_names.list(page_size=3, page_token=page.next_page_token)
    assert [name.object_id for name in (*page.names, *rest.names)] == [3, 2, 1, 3] and rest.next_page_token == ""


def _suggest(service: SceneService, scene_id: str, obj: int, name: str, source: str) -> None:
    suggested = (SuggestedName(obj, name, 0.8, source),)
    service.versions.edit(scene_id, [Edit("suggest", suggestions=suggested)])


def test_what_people_confirm_in_one_scene_weighs_sources_in_the_others_until_it_is_undone(
    service: SceneService, add: Callable[..., str]
) -> None:
    first, second, stranger = add(3, 7, 9), add(20, 21, 22), add(20, 21, 22, project="a")
    for scene_id in (first, second):
        for obj in (1, 2, 3):
            _suggest(service, scene_id, obj, f"{_WORDS[obj]}", "eyes")
            _suggest(service, scene_id, obj, "mug", "ears")
    elsewhere = service.in_project("a")
    _suggest(elsewhere, stranger, 1, "carrot", "eyes")

    def says(source: str) -> float:
        claims = [claim for name in _suggested(service, second)[1] for claim in name.said_by if claim.source == source]
        return claims[0].probability

    assert says("eyes") == says("ears") == pytest.approx(0.8)
    for obj in (1, 2, 3):
        _name(service, first, obj, _WORDS[obj])
    assert says("ears") == pytest.approx(0.8 * 4 / 6.4) and says("eyes") == pytest.approx(0.8 * 7 / 6.4)
    (answer,) = service.answers.query(QueryRequest(second, ("mug",))).answers
    assert answer.probability == pytest.approx(says("ears"))
    (unmoved,) = _suggested(elsewhere, stranger)[1]
    assert unmoved.probability == 0.8  # another project
    service.versions.undo(first)
    assert says("ears") == pytest.approx(0.8 * 4 / 5.6)
    service.versions.redo(first)
    assert says("ears") == pytest.approx(0.8 * 4 / 6.4)
    _name(service, first, 3, "submarine")  # refused by a name of one's own
    assert says("eyes") == pytest.approx(0.8 * 6 / 6.4)
    service.delete_scene(first)
    assert says("eyes") == says("ears") == pytest.approx(0.8)


def test_a_tag_names_what_bears_it_in_other_captures_until_the_name_is_taken_back(
    service: SceneService, add: Callable[..., str]
) -> None:
    first, second = add(1, 2, 3, tags=("17", "", "")), add(4, 5, 6, tags=("", "40", "17"))
    project_a = service.in_project("a")
    stranger = add(4, 5, 6, project="a", tags=("17", "", ""))
    _name(service, first, 1, "carrot")
    suggested = _suggested(service, second)
    assert list(map(len, suggested.values())) == [0, 0, 1]
    (guess,) = suggested[3]
    assert (guess.name, guess.scene_id) == ("carrot", first) and guess.probability == pytest.approx(0.97 * 0.98**2)
    assert [claim.source for claim in guess.said_by] == ["tag"]
    assert not any(obj.suggestions for obj in project_a.answers.list_objects(stranger).objects)
    assert _outcome(service, second, "carrot") == "probably_here"
    assert not any(obj.name for obj in service.answers.list_objects(second).objects)
    assert [known.picture for known in service.known_names.list().names] == [b""]
    seen = SuggestedName(3, "carrot", 0.5, "assistant")
    service.versions.edit(second, [Edit("suggest", suggestions=(seen,))])
    (guess,) = _suggested(service, second)[3]
    assert {claim.source for claim in guess.said_by} == {"tag", "assistant"}
    assert guess.probability == pytest.approx(1 - (1 - 0.97 * 0.98**2) * 0.5)
    service.versions.undo(first)
    assert [claim.source for claim in _suggested(service, second)[3][0].said_by] == ["assistant"]
    with pytest.raises(InvalidInputError, match="source"):
        service.versions.edit(second, [Edit("suggest", suggestions=(replace(seen, source="tag"),))])


@pytest.mark.parametrize("kind", sorted(KINDS.keys() - {"create_scene"}))
def test_a_version_that_a_job_makes_keeps_names_and_gives_its_own(
    service: SceneService, add: Callable[..., str], kind: OperationKind
) -> None:
    scene_id, store, stages = add(3, 7, 9), service._store, KINDS[kind].stages
    _name(service, scene_id, 2, "mug")
    order = order_job(kind, scene_id, "", {}, "default")
    store.scenes.add_job(order)
    claim = store.jobs.claim(order.operation_id)
    assert claim is not None
    claimed, settings = ClaimedJob(store, claim, service._context.settings.calls), service._context.settings
    upload, version = claimed.current_version()
    job = Job(order.operation_id, 1, upload, claimed.folder, claimed.options, settings, stages, {}, version)
    scene = read_scene(upload / "artefact")
    assert scene.objects is not None
    first, *rest = scene.objects.table
    named = replace(first, name="moon", source="person", probability=1.0)
    scene = replace(scene, objects=replace(scene.objects, table=(named, *rest)))
    folder = start_stage(job, stages[-1])
    edits = [to_plain(Edit("name", object_ids=(1,), name="moon"))]
    write_renamed(job, scene, folder, {"result": {}, "edits": edits})
    finish_stage(job, stages[-1], folder, 1.0)
    KINDS[kind].publish(claimed, stages[-1])
    assert _current(service, scene_id) == claimed.run_id
    assert {(obj, name) for _, obj, name, _ in _known(service)} == {(1, "moon"), (2, "mug")}


_HERE = Place(point=Vector3(0.0, 0.0, 0.0))
_MOVED = Pose(Vector3(0.0, -2.0, 0.0), Quaternion(0.0, 0.0, 0.0, 1.0))
_EDITS = (
    *(Edit(action, object_ids=(2,)) for action in ("remove", "unname", "discard")),
    *(Edit(action, object_ids=(2,), transform=_MOVED) for action in ("move", "duplicate", "insert")),
    Edit("recolor", object_ids=(2,), color=Color(1.0, 0.0, 0.0)),
    Edit("name", object_ids=(2,), name="carrot"),
    Edit("merge", object_ids=(2, 3)),
    Edit("scale", known_lengths=(KnownLength(_HERE, Place(point=Vector3(1.0, 0.0, 0.0)), 2.0),)),
    Edit("align", alignment=Alignment("map", _MOVED)),
    Edit("suggest", suggestions=(SuggestedName(2, "carrot", 0.8, "eyes"),)),
)


def test_no_edit_of_other_objects_forgets_a_name(service: SceneService, add: Callable[..., str]) -> None:
    # A prompt needs a segmenter; the last two are no edits to send.
    assert {edit.action for edit in _EDITS} == {*get_args(EditAction)} - {"split", "add", "look_again", "observe"}
    for edit in _EDITS:
        scene_id = add(3, 7, 9)
        _name(service, scene_id, 1, "moon")
        source = InsertSource(add(1, 2, 3)) if edit.action == "insert" else None
        service.versions.edit(scene_id, [replace(edit, source=source)], looked_at=_current(service, scene_id))
        assert (scene_id, 1, "moon", bytes([3])) in _known(service), edit.action
