"""A scene of a folder, asked without a server: the answers are the service's."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

import fastsplat
from fastsplat.service.application.service import open_service
from fastsplat.service.library.local_scene import LocalScene, folder_settings
from fastsplat_contract.errors import InvalidInputError, NotFoundError, NotReadyError
from fastsplat_contract.messages.queries import QueryRequest
from tests.api.made_scene import LABELS, add_scene, write_words
from tests.api.training_job import add_training_job
from tests.commands import invoke


@pytest.fixture(autouse=True)
def _environment(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Words for an encoder, and settings of a server that are not those of a folder."""
    write_words(tmp_path / "models")
    monkeypatch.setenv("FASTSPLAT_MODELS", str(tmp_path / "models"))
    monkeypatch.setenv("FASTSPLAT_PERCEPTION__TEXT_ENCODER", "label_table:words")
    monkeypatch.setenv("FASTSPLAT_QUERY__BACKEND", "cpu")
    monkeypatch.setenv("FASTSPLAT_QUERY__THRESHOLD", "0.5")
    monkeypatch.setenv("FASTSPLAT_QUERY__EXACT_THRESHOLD", "0.95")
    monkeypatch.setenv("FASTSPLAT_DATABASE_URL", "postgresql://nobody@127.0.0.1:1/elsewhere")
    monkeypatch.setenv("FASTSPLAT_ARTEFACTS__URL", "s3://elsewhere/folder")


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    settings = folder_settings(tmp_path / "room")
    with open_service(settings) as service:
        add_scene(service, settings)
    return tmp_path / "room"


@pytest.fixture
def scene(folder: Path) -> Iterator[LocalScene]:
    with fastsplat.open_scene(folder) as opened:
        yield opened


def test_a_folder_answers_as_the_service_does(scene: LocalScene, folder: Path) -> None:
    with open_service(folder_settings(folder)) as service:
        for text in ("mug", "cup", "elephant"):
            request = QueryRequest(scene.id, (text,), views=("front.png",), outputs=frozenset({"objects", "mask2d"}))
            (answer,) = service.answers.query(request).answers
            assert scene.ask(text, viewpoints=("front.png",)) == answer
    assert scene.ask("elephant").is_absent


def test_masks_show_what_answers(scene: LocalScene) -> None:
    mask, inside = scene.mask("mug", "front.png"), scene.mask3d("mug")
    mug = next(obj for obj in scene.objects() if obj.name == "mug")
    assert inside.shape == (scene.info.gaussians,) and inside.sum() == mug.gaussian_count
    image = scene.image("front.png").astype(float)
    assert mask.shape == image.shape[:2]
    inside_color = image[mask].mean(axis=0)
    assert inside_color[0] > 2 * inside_color[1]  # the mug is red, and nothing else is


def test_a_free_viewpoint_is_as_good_as_the_camera_that_stands_there(scene: LocalScene) -> None:
    posed = scene.info.cameras[1]
    assert np.array_equal(scene.mask("ball", posed), scene.mask("ball", posed.name))
    assert np.array_equal(scene.image(posed), scene.image(posed.name))


def test_every_object_is_listed_and_measured(scene: LocalScene) -> None:
    objects = scene.objects()
    assert {obj.name for obj in objects} >= set(LABELS)
    first, second = objects[0], objects[1]
    measured = scene.measure(first.id, second.id)
    assert measured.meters and measured.distance is not None and measured.distance.value > 0
    assert len(scene.measure(first.id).sides) == 3


def test_a_name_is_there_for_whoever_opens_the_folder_next(scene: LocalScene, folder: Path) -> None:
    ball = next(obj for obj in scene.objects() if obj.name == "ball")
    version = scene.name(ball.id, "beaker")
    assert scene.info.version == version.version
    with fastsplat.open_scene(folder) as again:
        assert again.ask("beaker").object_ids == (ball.id,)


def test_a_picture_shows_the_answer_and_says_it(scene: LocalScene, tmp_path: Path) -> None:
    picture = scene.show("mug")
    assert picture.sentence == scene.ask("mug").sentence
    assert picture._repr_png_() == picture.png and picture.array().shape[2] == 3
    picture.save(tmp_path / "mug.png")
    assert (tmp_path / "mug.png").read_bytes() == picture.png
    absent = scene.show("elephant")
    assert absent.sentence == scene.ask("elephant").sentence and absent.png != picture.png
    assert scene.show().array().std() > 1


def test_a_folder_without_a_scene_is_said_to_be_one_and_stays_as_it_is(tmp_path: Path) -> None:
    (tmp_path / "empty").mkdir()
    for place in (tmp_path / "empty", tmp_path / "nowhere"):
        with pytest.raises(NotFoundError, match="no scene"):
            fastsplat.open_scene(place)
    assert list((tmp_path / "empty").iterdir()) == [] and not (tmp_path / "nowhere").exists()


def test_a_scene_that_is_not_trained_to_its_end_is_not_opened(tmp_path: Path) -> None:
    with open_service(folder_settings(tmp_path / "room")) as service:
        add_training_job(service)
    with pytest.raises(NotReadyError, match="not been trained"):
        fastsplat.open_scene(tmp_path / "room")


def test_the_package_has_no_other_names() -> None:
    with pytest.raises(AttributeError, match="no attribute 'tran'"):
        fastsplat.tran  # noqa: B018  that it raises is the point


@pytest.mark.parametrize("texts", [["mug"], ["mug", "elephant"]])
def test_the_command_says_what_the_scene_says(scene: LocalScene, folder: Path, texts: list[str]) -> None:
    said = invoke("ask", str(folder), *texts)
    assert said.exit_code == 0, said.output
    assert all(scene.ask(text).sentence in said.stdout for text in texts)
    assert "object 1, mug, at (" in said.stdout and "m\n" in said.stdout
    result = invoke("scenes", "show", str(folder), "--json")
    assert json.loads(result.stdout)["id"] == scene.id


def test_the_command_draws_one_answer(scene: LocalScene, folder: Path, tmp_path: Path) -> None:
    assert invoke("ask", str(folder), "mug", "--picture", str(tmp_path / "a.png")).exit_code == 0
    assert (tmp_path / "a.png").read_bytes() == scene.show("mug").png
    refused = invoke("ask", str(folder), "mug", "ball", "--picture", str(tmp_path / "b.png"))
    assert isinstance(refused.exception, InvalidInputError) and "one picture of 2" in refused.exception.message
