"""A service with WordNet asks for the kind of a name, and its status says whether answers use the lexicon."""

from __future__ import annotations

from pathlib import Path

import pytest

from fastsplat.service.application.admin.server_capabilities import server_status
from fastsplat.service.application.service import SceneService, open_service
from fastsplat.service.perception.perception_settings import PerceptionSettings
from fastsplat.service.perception.text.text_encoders import open_text_encoder
from fastsplat.service.query.query_settings import QuerySettings
from fastsplat.service.settings import Settings
from fastsplat_contract.messages.queries import QueryRequest
from fastsplat_contract.messages.scenes import Edit
from tests.api.made_scene import made_scene
from tests.api.served import on_free_ports
from tests.scenes import store_scene


def _settings(models: Path, folder: Path, lexicon: str = "wordnet", **query: object) -> Settings:
    return on_free_ports(
        data_dir=folder / "data",
        models=models,
        perception=PerceptionSettings(lexicon=lexicon),
        query=QuerySettings.model_validate({"backend": "cpu"} | query),
    )


def test_a_name_of_which_no_word_is_known_is_asked_for_its_kind_once(lexicon_models_dir: Path, tmp_path: Path) -> None:
    settings = _settings(lexicon_models_dir, tmp_path)
    scene = made_scene(open_text_encoder("minilm_l6_int8", lexicon_models_dir, threads=1))

    def name(obj: int, text: str, *kinds: str) -> Edit:
        return Edit("name", object_ids=(obj,), name=text, kinds=kinds)

    with open_service(settings) as service:
        scene_id = store_scene(service._store, scene, "made")
        edit = service.versions.edit
        assert not edit(scene_id, [name(1, "grandma's mug")]).asks_kind
        without_kind = edit(scene_id, [name(2, "Oskar")], "the-request")
        assert without_kind.asks_kind and edit(scene_id, [name(2, "Oskar")], "the-request") == without_kind
        with_kind = edit(scene_id, [name(2, "Oskar", "teddy bear")])
        assert not with_kind.asks_kind and with_kind.edits[0].kinds == ("teddy bear",)
        assert not edit(scene_id, [name(3, "Oskar")]).asks_kind  # its kind is known by now
        (answer,) = service.answers.query(QueryRequest(scene_id, ("toy",))).answers
        assert answer.relation == "kind_of" and set(answer.object_ids) == {2, 3}
        assert [version.asks_kind for version in service.versions.all(scene_id)] == [False, False, True, False, False]


@pytest.mark.parametrize(
    ("lexicon", "query", "state", "used"),
    [("wordnet", {}, "ready", True), ("wordnet", {"threshold": 0.4}, "ready", False), ("", {}, "unset", None)],
)
def test_the_status_says_whether_answers_use_the_lexicon(
    lexicon_models_dir: Path, tmp_path: Path, lexicon: str, query: dict[str, object], state: str, used: bool | None
) -> None:
    settings = _settings(lexicon_models_dir, tmp_path, lexicon, **query)
    with open_service(settings) as service:
        assert _status(service, settings) == (state, used)


def test_the_status_names_a_lexicon_that_was_never_fetched(tmp_path: Path) -> None:
    (tmp_path / "models").mkdir()
    settings = _settings(tmp_path / "models", tmp_path)
    with open_service(settings) as service:
        assert _status(service, settings) == ("missing", None)


def _status(service: SceneService, settings: Settings) -> tuple[str, bool | None]:
    status = server_status(service._store, settings, "", "admin", "")
    (found,) = [model for model in status.models if model.role == "lexicon"]
    return found.state, found.calibrated
