"""Every example in the API's description is of its schema, and a server takes it and answers as described."""

from __future__ import annotations

import json
from collections.abc import Iterator
from functools import cache
from typing import Any

import httpx
import jsonschema_rs
import pytest

from fastsplat.api.examples.example_parameters import IDS
from fastsplat.api.rest import openapi
from fastsplat.api.rest.problem_answers import MEDIA_TYPE as PROBLEM
from fastsplat.service.application.service import SceneService, open_service
from fastsplat.service.settings import CaptionerSettings, Settings
from tests.api.made_scene import OBSERVED, PLAIN_PNG, add_known_name, add_scene
from tests.api.served import Faces, served
from tests.api.training_job import add_cancelled_job, add_training_job
from tests.api.uploaded import zipped
from tests.api.upright_scene import add_upright_scene

_DOCUMENT: dict[str, Any] = json.loads(openapi.COMMITTED.read_text())
_OPERATIONS = {
    operation["operationId"]: (method, path, operation)
    for path, methods in _DOCUMENT["paths"].items()
    for method, operation in methods.items()
}
_TUS = {"create_upload", "append_to_upload", "get_upload", "delete_upload"}
"""Those need headers of tus, which its own specification describes; see test_api_tus."""
_OF_TRAINING = {"finish_operation", "get_preview", "get_preview_picture", "get_placed_cameras", "get_job_log"}
_CAPTIONER = "localhost:11434"  # the host of the examples


def _valid(value: Any, schema: dict[str, Any]) -> None:
    """Fail unless a value is of a schema of the document."""
    errors = _validator(json.dumps(schema)).iter_errors(value)
    assert [f"{error.instance_path}: {error.message}" for error in errors] == []


@cache
def _validator(schema: str) -> jsonschema_rs.Draft202012Validator:
    return jsonschema_rs.Draft202012Validator({**json.loads(schema), "components": _DOCUMENT["components"]})


def _examples(content: dict[str, Any]) -> Iterator[Any]:
    if "example" in content:
        yield content["example"]
    for example in content.get("examples", {}).values():
        name = example.get("$ref", "").rpartition("/")[2]
        yield (_DOCUMENT["components"]["examples"][name] if name else example)["value"]


@pytest.mark.parametrize("name", _OPERATIONS)
def test_all_that_is_sent_and_each_refusal_have_examples_of_their_schema(name: str) -> None:
    operation = _OPERATIONS[name][2]
    for parameter in operation.get("parameters", ()):
        _valid(parameter["example"], parameter["schema"])
    answers = [response.get("content", {}) for response in operation["responses"].values()]
    refusals = [{PROBLEM: content[PROBLEM]} for content in answers if PROBLEM in content]
    for contents in (operation.get("requestBody", {}).get("content", {}), *refusals):
        for media_type, content in contents.items():
            if media_type != "application/offset+octet-stream":
                values = list(_examples(content))
                assert values, media_type
                for value in values:
                    _valid(value, content["schema"])


class _Place:
    """A server of these tests' own, and what there is on it by the names of the examples' ids."""

    def __init__(self, faces: Faces, service: SceneService, settings: Settings) -> None:
        self.faces = faces
        self.service = service
        self._settings = settings

    def ids(self, *, training: bool = False) -> dict[str, str]:
        """Ids of a new edited scene and its job, or of a job that trains."""
        scene_id = add_scene(self.service, self._settings)
        color = {"r": 0, "g": 1, "b": 0}
        edit = {"edits": [{"action": "recolor", "label": "mug", "color": color}]}
        version = self.faces.rest.post(f"/v1/scenes/{scene_id}:edit", json=edit).json()
        operation_id = self.service.get_scene(scene_id).operation_id
        if training:
            operation_id = add_training_job(self.service).operation.id
        key_id = self.service.admin.keys.create("a key", "reader")[0].id
        return {
            "scene_id": scene_id,
            "operation_id": operation_id,
            "version": version["version"],
            "key_id": key_id,
            "name_id": add_known_name(self.service, scene_id),
            "observation_id": OBSERVED,
        }


@pytest.fixture(scope="module")
def place(api_settings: Settings, tmp_path_factory: pytest.TempPathFactory) -> Iterator[_Place]:
    captioner = CaptionerSettings(
        url=f"http://{_CAPTIONER}/v1", model="never asked: the objects of these scenes have names"
    )
    folder = tmp_path_factory.mktemp("examples")
    settings = api_settings.model_copy(update={"data_dir": folder, "captioner": captioner})
    with open_service(settings) as service, served(service, settings) as faces:
        yield _Place(faces, service, settings)


def _sent(place: _Place, name: str, body: Any, ids: dict[str, str]) -> httpx.Response:
    """The answer to an example, with ids of what is there in the place of the example's."""
    method, path, operation = _OPERATIONS[name]
    parameters = [p for p in operation.get("parameters", ()) if p["name"] != "page_token"]  # of another server's page
    in_path, params = ({p["name"]: p["example"] for p in parameters if p["in"] == where} for where in ("path", "query"))
    request = json.dumps([in_path, params, body])
    for kind, value in ids.items():
        request = request.replace(IDS[kind], value)
    in_path, params, body = json.loads(request)
    return place.faces.rest.request(method, path.format(**in_path), params=params, json=body)


@pytest.mark.parametrize("name", sorted(set(_OPERATIONS) - _TUS - {"create_scene", "localize", "observe_scene"}))
def test_a_server_takes_every_example_and_answers_as_described(place: _Place, name: str) -> None:
    operation = _OPERATIONS[name][2]
    contents = operation.get("requestBody", {}).get("content", {})
    bodies = [body for content in contents.values() for body in _examples(content)] or [None]
    for body in bodies:
        ids = place.ids(training=name in _OF_TRAINING)
        if name == "redo_edit":
            place.service.versions.undo(ids["scene_id"])
        if name == "get_goal":  # of a scene whose z is up
            upright = add_upright_scene(place.service, place._settings)
            ids |= {"scene_id": upright, "version": place.service.versions.resolve(upright)}
        if name == "ask_captioner":
            place.service.captioner.agree(_CAPTIONER)
        if name == "retry_operation":
            ids["operation_id"] = add_cancelled_job(place.service, "IMG_0012.jpg")
        response = _sent(place, name, body, ids)
        assert response.is_success, (body, response.text)
        described = operation["responses"][str(response.status_code)].get("content", {})
        media_type = response.headers.get("content-type", "").partition(";")[0]
        assert (media_type in described) == bool(described), (media_type, described)
        if media_type == "application/json":
            _valid(response.json(), described[media_type]["schema"])
        elif media_type == "text/event-stream":
            fields = [line.split(": ", 1) for line in response.text.splitlines() if ": " in line]
            _valid(dict(fields), described[media_type]["schema"])


def test_the_form_of_the_example_posts_a_scene(place: _Place) -> None:
    form = next(_examples(_OPERATIONS["create_scene"][2]["requestBody"]["content"]["multipart/form-data"]))
    capture = zipped(3)
    uploads = place.service.resumable
    upload_id = uploads.create("default", "capture.zip", len(capture)).id
    piece = uploads.begin_piece("default", upload_id, 0)
    piece.write(capture)
    piece.finish()
    piece.close()
    assert form["uploads"] == [IDS["upload_id"]]
    texts = [(key, text) for key, value in form.items() for text in (value if isinstance(value, list) else [value])]
    real = {IDS["upload_id"]: upload_id}
    parts = [(key, (None, real.get(value, str(value)))) for key, value in texts]
    response = place.faces.rest.post("/v1/scenes", files=parts)
    assert response.status_code == 202, response.text
    described = _OPERATIONS["create_scene"][2]["responses"]["202"]["content"]["application/json"]
    _valid(response.json(), described["schema"])


def test_the_form_of_the_example_localizes_photos(place: _Place) -> None:
    form = next(_examples(_OPERATIONS["localize"][2]["requestBody"]["content"]["multipart/form-data"]))
    photos = [("photos", (name, PLAIN_PNG)) for name in form["photos"]]  # an example has names for bytes
    texts = [(key, (None, str(value))) for key in ("focals", "poses") for value in form[key]]
    path = f"/v1/scenes/{place.ids()['scene_id']}:localize"
    response = place.faces.rest.post(path, files=[*photos, *texts])
    assert response.status_code == 200, response.text
    answer = response.json()
    assert [photo["refusal"] for photo in answer["photos"]] == ["no_keypoints"] * len(form["photos"])
    described = _OPERATIONS["localize"][2]["responses"]["200"]["content"]["application/json"]
    _valid(answer, described["schema"])
