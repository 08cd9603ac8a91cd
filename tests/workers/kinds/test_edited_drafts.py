"""Edits of drafts: they hold in the finished scene, by object, or are said to be lost."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path

import numpy as np
import pytest

from fastsplat.service.query.query_settings import QuerySettings
from fastsplat.service.settings import CallSettings
from fastsplat.workers.job.made_scenes import EDITS
from fastsplat_contract.geometry.poses import Pose, Quaternion, Vector3
from fastsplat_contract.jobs.operations import Operation
from fastsplat_contract.messages.queries import QueryRequest
from fastsplat_contract.messages.scenes import Color, Edit
from tests.api.made_scene import write_words
from tests.workers.deployment import Deployment, new_database
from tests.workers.draft_scenes import DRAFT_IDS, FINAL_IDS, ONLY_IN_DRAFT, PLACES

_UP = Pose(Vector3(0.0, -2.0, 0.0), Quaternion(0.0, 0.0, 0.0, 1.0))
_LEFT, _MIDDLE, _RIGHT = DRAFT_IDS


@pytest.fixture
def words(tmp_path: Path, request: pytest.FixtureRequest) -> Iterator[Deployment]:
    """A deployment whose jobs make scenes of objects, and ask a text encoder."""
    write_words(tmp_path / "models", "Oskar", "ghost", "twin")
    with ExitStack() as opened:
        query = QuerySettings(backend="reference")
        few = CallSettings(max_versions=3)  # of a finished scene: what people make of a draft all stays
        deployment = Deployment(
            tmp_path, new_database(request, opened), models=tmp_path / "models", query=query, calls=few
        )
        deployment.start_worker(FASTSPLAT_MODELS=str(tmp_path / "models"))
        yield deployment
        deployment.close()


def _drafted(deployment: Deployment, *orders: str) -> Operation:
    operation = deployment.post("training:draft", *orders)
    deployment.wait_for(lambda: deployment.service.get_operation(operation.id).draft is not None)
    return operation


def _tell(deployment: Deployment) -> None:
    (deployment.settings.data_dir / "told.txt").touch()


def _names(deployment: Deployment, operation: Operation) -> dict[int, str]:
    objects = deployment.service.answers.list_objects(operation.scene_id).objects
    return {obj.id: obj.name for obj in objects}


def test_edits_of_a_draft_hold_by_object(words: Deployment) -> None:
    """Names, colors, copies follow their objects whatever the ids; undone edits do not; each is its own version."""
    operation = _drafted(words, "training:until_told")
    edit = words.service.versions.edit
    scene_id = operation.scene_id
    named = [Edit("name", object_ids=(_RIGHT,), name="Oskar"), Edit("name", object_ids=(ONLY_IN_DRAFT,), name="ghost")]
    edit(scene_id, named, "a-request")
    edit(scene_id, [Edit("recolor", object_ids=(_LEFT, ONLY_IN_DRAFT), color=Color(1.0, 0.0, 0.0))])
    edit(scene_id, [Edit("duplicate", object_ids=(_MIDDLE,), transform=_UP)])
    copy = max(_names(words, operation))
    edit(scene_id, [Edit("name", object_ids=(copy,), name="twin")])
    edit(scene_id, [Edit("discard", object_ids=(_LEFT,))])
    words.service.versions.undo(scene_id)
    answer = words.service.answers.query(QueryRequest(scene_id, ("Oskar",))).answers[0]
    assert answer.provisional is not None and answer.object_ids == (_RIGHT,)
    _tell(words)
    done = words.wait_over(operation)
    assert done.state == "SUCCEEDED"
    left, middle, right = FINAL_IDS
    names = _names(words, operation)
    assert names == {left: "", middle: "", right: "Oskar", max(names): "twin"} and len(names) == 4
    answer = words.service.answers.query(QueryRequest(scene_id, ("Oskar",))).answers[0]
    assert (answer.object_ids, answer.provisional) == ((right,), None)
    twin = next(t for t in words.service.answers.list_objects(scene_id).objects if t.name == "twin")
    assert abs(twin.centroid.x - PLACES[1]) < 0.2 and abs(twin.centroid.y + 2.0) < 0.2
    assert done.create_scene is not None and done.create_scene.carried == 4
    known = {
        name.name: np.frombuffer(name.appearance[-6:], np.float16) for name in words.service._store.known_names.all()
    }
    assert known.keys() == {"Oskar", "twin"}, "what they are known by in other scenes"
    assert all(size == pytest.approx([0.1] * 3, abs=0.05) for size in known.values()), "their spread in meters"
    assert [text.partition(":")[0] for text in done.create_scene.lost] == ["name 'ghost'", "recolor"]
    versions = words.service.versions.all(scene_id)
    assert [[change.action for change in version.edits] for version in versions] == [
        [], ["name"], ["recolor"], ["duplicate"], ["name"],
    ]  # fmt: skip
    assert edit(scene_id, named, "a-request").version == versions[1].version
    for _ in versions[1:]:
        words.service.versions.undo(scene_id)
    assert set(_names(words, operation).values()) == {""}
    words.wait_for(lambda: len(list((words.settings.data_dir / "scenes" / scene_id).iterdir())) == len(versions))


def test_an_edit_at_the_last_moment_holds(words: Deployment) -> None:
    """One that comes when the scene is already made is in it all the same, and costs no stage again but the last."""
    operation = _drafted(words, "export:until_told")
    words.wait_in("export", operation)
    words.service.versions.edit(operation.scene_id, [Edit("name", object_ids=(_LEFT,), name="Oskar")])
    _tell(words)
    assert words.wait_over(operation).error is None
    assert _names(words, operation)[FINAL_IDS[0]] == "Oskar"
    assert [len(words.visits(stage, operation)) for stage in ("training", "export")] == [1, 2]


def test_a_draft_takes_over_edits_of_the_one_before_and_loses_none(words: Deployment) -> None:
    """A later draft has the names of the one before; its objects are the same, so the names hold to the end."""
    operation = _drafted(words, "training:until_told", "training:draft", "export:until_asked")
    words.service.versions.edit(operation.scene_id, [Edit("name", object_ids=(_MIDDLE,), name="Oskar")])
    # Until the worker has seen it: a draft made without it is not published.
    words.wait_for(lambda: any("Oskar" in path.read_text() for path in words.settings.data_dir.rglob(EDITS)))
    _tell(words)
    words.wait_for(lambda: (draft := words.service.get_operation(operation.id).draft) and draft.number == 2)
    assert _names(words, operation)[_MIDDLE] == "Oskar"
    (words.settings.data_dir / "asked.txt").touch()
    assert words.wait_over(operation).error is None
    assert _names(words, operation)[FINAL_IDS[1]] == "Oskar"
