"""What a release's REST and gRPC promise, and what a later one broke of it: `python -m release.wire` writes it once.

Promised are paths, parameters, fields, their types, numbers and values, and that a call needs no more than it did.
Prose, examples and limits may change, and what was deprecated may go.
"""

from __future__ import annotations

import json
import tomllib
import zipfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from google.protobuf.descriptor_pb2 import DescriptorProto, FileDescriptorProto

from fastsplat.api.rest import openapi
from fastsplat_contract.v1 import fastsplat_pb2

RELEASED = Path(__file__).with_name("released")

_ROOT = Path(__file__).parents[1]
_FREE = {"description", "summary", "title", "example", "examples", "default", "tags", "info", "servers", "pattern"}
_FREE |= {f"{end}{what}" for end in ("min", "max") for what in ("imum", "Length", "Items", "Properties")}
_NAMES = {"paths", "properties", "schemas", "responses"}
"""Below these stand names, which may be called as prose is."""

Promises = set[tuple[Any, ...]]


def rest_broken(before: Any, now: Any) -> Promises:
    """What a description (OpenAPI, parsed) no longer says, or newly demands of calls that were there before."""
    calls = {f"{method} {path}" for path, methods in before["paths"].items() for method in methods}
    there = before["components"]["schemas"].keys() | calls
    demanded = {demand for demand in _demanded(now) - _demanded(before) if demand[0] in there}
    return set(_said(before)) - set(_said(now)) | demanded


def grpc_promises(file: FileDescriptorProto) -> Promises:
    """Fields, values of enumerations and calls."""
    said: Promises = {row for message in file.message_type for row in _fields(message, message.name)}
    said |= {(kind.name, value.name, value.number) for kind in file.enum_type for value in kind.value}
    return said | {
        (call.name, call.input_type, call.output_type, call.client_streaming, call.server_streaming)
        for service in file.service
        for call in service.method
        if not call.options.deprecated
    }


def grpc_today() -> FileDescriptorProto:
    """The messages and calls of this tree."""
    return FileDescriptorProto.FromString(fastsplat_pb2.DESCRIPTOR.serialized_pb)


def read_release(archive: Path) -> tuple[Any, FileDescriptorProto]:
    """The REST description and the gRPC messages of a release."""
    with zipfile.ZipFile(archive) as file:
        return json.loads(file.read("openapi.json")), FileDescriptorProto.FromString(file.read("fastsplat.pb"))


def main() -> None:
    """Write this release's; it must not be there yet."""
    version = tomllib.loads((_ROOT / "client/pyproject.toml").read_text())["project"]["version"]
    RELEASED.mkdir(exist_ok=True)
    name = f"{'.'.join(version.split('.')[:2])}.zip"
    with zipfile.ZipFile(RELEASED / name, "x", zipfile.ZIP_DEFLATED, compresslevel=9) as written:
        written.writestr("openapi.json", openapi.COMMITTED.read_text())
        written.writestr("fastsplat.pb", fastsplat_pb2.DESCRIPTOR.serialized_pb)


def _said(node: Any, path: tuple[str, ...] = ("",)) -> Iterator[tuple[Any, ...]]:
    """Each value of a description with its path, in which parameters have their names."""
    if isinstance(node, list):
        for item in node:
            yield from _said(item, (*path, item.get("name", "") if isinstance(item, dict) else ""))
    elif not isinstance(node, dict):
        yield (*path, node)
    elif node.get("deprecated") is not True:
        for key, value in node.items():
            if key not in _FREE or path[-1] in _NAMES:
                yield from _said(value, (*path, key))


def _demanded(document: Any) -> Promises:
    """What callers must send: (call or schema, parameter or field)."""
    found: Promises = set()
    seen: set[str] = set()

    def walk(node: Any, where: str) -> None:
        if isinstance(node, dict):
            name = node.get("$ref", "").rpartition("/")[2]
            if name and name not in seen:
                seen.add(name)
                walk(document["components"]["schemas"][name], name)
            required = node.get("required")
            found.update((where, field) for field in (required if isinstance(required, list) else ()))
        for child in node.values() if isinstance(node, dict) else node if isinstance(node, list) else ():
            walk(child, where)

    for path, methods in document["paths"].items():
        for method, operation in methods.items():
            walk(operation.get("requestBody"), f"{method} {path}")
            parameters = (item for item in operation.get("parameters", ()) if item.get("required"))
            found.update((f"{method} {path}", item["name"]) for item in parameters)
    return found


def _fields(message: DescriptorProto, path: str) -> Iterator[tuple[Any, ...]]:
    for field in message.field:
        choice = message.oneof_decl[field.oneof_index].name if field.HasField("oneof_index") else ""
        yield (path, field.name, field.number, field.type, field.label, field.type_name, choice)
    for inner in message.nested_type:
        yield from _fields(inner, f"{path}.{inner.name}")


if __name__ == "__main__":
    main()
