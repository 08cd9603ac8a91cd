"""`fastsplat scenes`: scenes are renamed, and what became of their photos is listed."""

from __future__ import annotations

import json
from collections.abc import Callable

import pytest
from typer.testing import CliRunner, Result

from fastsplat.cli.main import app
from fastsplat.service.application.service import SceneService
from fastsplat.service.settings import load_settings
from fastsplat_contract.errors import LimitExceededError, NotFoundError
from fastsplat_contract.json_codec import to_plain
from fastsplat_contract.photo_verdicts import PhotoVerdict
from tests.api.made_scene import add_scene
from tests.scenes import queued_job


@pytest.fixture
def scenes() -> Callable[..., Result]:
    return lambda *words: CliRunner().invoke(app, ["scenes", *words])


def test_a_scene_is_renamed(scenes: Callable[..., Result], service: SceneService) -> None:
    scene_id = add_scene(service, load_settings())
    assert scenes("rename", scene_id, "my desk").exit_code == 0
    assert service.get_scene(scene_id).name == "my desk"
    assert isinstance(scenes("rename", scene_id, "x" * 10_000).exception, LimitExceededError)
    assert isinstance(scenes("rename", "none", "my desk").exception, NotFoundError)
    assert isinstance(scenes("rename", scene_id, "x", "--project", "other").exception, NotFoundError)


def test_what_became_of_its_photos_is_listed(scenes: Callable[..., Result], service: SceneService) -> None:
    job = queued_job()
    service._store.scenes.create(job)
    claim = service._store.jobs.claim(job.operation_id)
    assert claim is not None
    unseen = scenes("photos", job.scene_id)
    assert unseen.exit_code == 0 and "nobody has looked" in unseen.stderr and not unseen.stdout
    lost = PhotoVerdict("[b]1.jpg", False, "no_overlap", ("blurred",), "", 0.3, 0.8, 0, "Take it again.")
    good = PhotoVerdict("2.jpg", True, None, (), "", 1.0, 0.8, 120, "")
    service._store.jobs.record_photos(claim, [to_plain(lost), to_plain(good)])
    listed = scenes("photos", job.scene_id)
    for text in ("[b]1.jpg", "not placed: no overlap", "blurred", "Take it again.", "2.jpg"):
        assert text in listed.stdout
    assert "1 of 2 photos have a place" in listed.stderr
    assert json.loads(scenes("photos", job.scene_id, "--json").stdout)[0] == to_plain(lost)
