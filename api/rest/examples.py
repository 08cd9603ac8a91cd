"""Adds examples to the OpenAPI document."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from fastsplat.api.errors import refusal_of
from fastsplat.api.examples import request_examples
from fastsplat.api.examples.example_parameters import PARAMETERS
from fastsplat.api.examples.request_examples import FORM, LOCALIZE_FORM, OBSERVE_FORM, Bodies
from fastsplat.api.rest.problem_answers import MEDIA_TYPE as PROBLEM
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
BODIES: Mapping[str, Bodies] = {
    type(next(iter(value.values()))[1]).__name__: value
    for name, value in vars(request_examples).items()
    if name.isupper() and not name.startswith("_") and not name.endswith(("FORM", "IDS"))
}
"""Example bodies by type name."""

_FORMS = {"localize": LOCALIZE_FORM, "observe_scene": OBSERVE_FORM}
"""Example forms by operation; all others use the upload's."""


def add_examples(document: dict[str, Any]) -> None:
    """Adds examples of all bodies, parameters and refusals to an OpenAPI document."""
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
            if PROBLEM in response.get("content", {}):
                examples = {name: {"$ref": f"#/components/examples/{name}"} for name in PROBLEMS[status]}
                response["content"][PROBLEM]["examples"] = examples


def _type_of(content: Mapping[str, Any]) -> str | None:
    """Finds the name of the schema that a body refers to; None without a reference."""
    choices = [content["schema"], *content["schema"].get("anyOf", ())]
    return next((choice["$ref"].rpartition("/")[2] for choice in choices if "$ref" in choice), None)
