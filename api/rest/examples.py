"""Adds examples to the OpenAPI document."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from typing import Any

from fastsplat.api.errors import refusal_of
from fastsplat.api.examples import admin_examples, change_examples, localize_examples, scene_examples
from fastsplat.api.examples.change_examples import Bodies
from fastsplat.api.examples.example_parameters import PARAMETERS
from fastsplat.api.examples.localize_examples import LOCALIZE_FORM, OBSERVE_FORM
from fastsplat.api.examples.scene_examples import FORM, OPERATION, VIEW
from fastsplat.api.rest.problem_answers import MEDIA_TYPE as PROBLEM
from fastsplat.service.application.exporting.camera_files import camera_list
from fastsplat_contract.codec.json_codec import to_plain
from fastsplat_contract.errors import FastSplatError, InvalidInputError, NotFoundError, OverloadedError

PROBLEMS: Mapping[str, Mapping[str, FastSplatError]] = {
    "4XX": {
        "NotFound": NotFoundError("no scene 'table'", field="scene_id"),
        "InvalidInput": InvalidInputError(
            "a coverage of 2", field="coverage", limit="above 0 and below 1", hint="Send a share, e.g. 0.9."
        ),
    },
    "5XX": {
        "Overloaded": OverloadedError(
            "the server has all the work it can answer in good time",
            limit="256 calls of all keys at a time (FASTSPLAT_LIMITS__ADMITTED)",
            hint="Wait a moment, then send it again.",
        )
    },
}
_EXAMPLES = [
    value
    for module in (admin_examples, change_examples, localize_examples, scene_examples)
    for name, value in vars(module).items()
    if name.isupper() and not name.startswith("_")
]
_ANSWERS: Mapping[str, Any] = {type(value).__name__: value for value in _EXAMPLES}
"""Example answers by type name."""
BODIES: Mapping[str, Bodies] = {
    type(example[1]).__name__: value
    for value in _EXAMPLES
    if isinstance(value, dict)
    for example in value.values()
    if isinstance(example, tuple)
}
"""Example bodies by type name."""

_FORMS = {"localize": LOCALIZE_FORM, "observe_scene": OBSERVE_FORM}
"""Example forms by operation; all others use the upload's."""


def add_examples(document: dict[str, Any]) -> None:
    """Adds examples of all bodies, parameters and non-binary answers to an OpenAPI document."""
    document["components"]["examples"] = {
        name: {"summary": error.message, "value": to_plain(refusal_of(error, "0b6a4d2c8e1f4a3d").as_problem())}
        for errors in PROBLEMS.values()
        for name, error in errors.items()
    }
    for operation in (operation for methods in document["paths"].values() for operation in methods.values()):
        for parameter in operation.get("parameters", ()):
            name = parameter["name"]
            parameter["example"] = PARAMETERS.get(f"{operation['operationId']} {name}", PARAMETERS.get(name))
        for media_type, content in operation.get("requestBody", {}).get("content", {}).items():
            if media_type == "multipart/form-data":
                content["example"] = dict(_FORMS.get(operation["operationId"], FORM))
            elif (kind := _type_of(content)) is not None:
                content["examples"] = {
                    name: {"summary": summary, "value": to_plain(value)}
                    for name, (summary, value) in BODIES[kind].items()
                }
        for status, response in operation["responses"].items():
            response["content"] = dict(_with_examples(status, response)) if "content" in response else {}
            if not response["content"]:
                del response["content"]


def _with_examples(status: str, response: Mapping[str, Any]) -> Iterator[tuple[str, Any]]:
    for media_type, content in response["content"].items():
        if media_type == PROBLEM:
            examples = {name: {"$ref": f"#/components/examples/{name}"} for name in PROBLEMS[status]}
            yield media_type, {**content, "examples": examples}
        elif media_type == "text/event-stream":
            event = {"id": "5b0c9f2e7d1a4b38", "event": "operation", "data": json.dumps(to_plain(OPERATION))}
            yield media_type, {**content, "example": event}
        elif (kind := _type_of(content)) is not None:
            yield media_type, {**content, "example": to_plain(_ANSWERS[kind])}
        elif media_type == "application/json":
            health = "additionalProperties" in content["schema"]
            example = {"status": "ok"} if health else json.loads(camera_list((VIEW,)))
            yield media_type, {**content, "example": example}
        else:
            yield media_type, content


def _type_of(content: Mapping[str, Any]) -> str | None:
    """Finds the name of the schema that a body refers to; None without a reference."""
    choices = [content["schema"], *content["schema"].get("anyOf", ())]
    return next((choice["$ref"].rpartition("/")[2] for choice in choices if "$ref" in choice), None)
