"""What `make docs` adds to the pages of this folder: the reference of Python, REST and gRPC, and linked files.

A hook of mkdocs. Python's reference is made of docstrings (mkdocstrings), REST's of `api/rest/openapi.json`, gRPC's of
the comments in `protos/`.
"""

from __future__ import annotations

import json
import re
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import grpc_tools
from google.protobuf.descriptor_pb2 import (
    DescriptorProto,
    EnumDescriptorProto,
    FieldDescriptorProto,
    FileDescriptorProto,
    FileDescriptorSet,
)
from grpc_tools import protoc
from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page

_ROOT = Path(__file__).resolve().parents[1]
_PROTOS = ("fastsplat/v1/fastsplat.proto", "fastsplat/v1/status.proto")
_OUTSIDE = re.compile(r"\]\(\.\./([^)#]+)")
"""A link from a page to a file of the repository that is no page."""
_METHODS = ("get", "post", "put", "patch", "delete", "head", "options")
_Schema = Mapping[str, Any]


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Adds the reference, and the files outside of this folder that pages link to."""
    for name, text in reference_pages().items():
        files.append(File.generated(config, f"reference/{name}", content=text))
    outside = {path for page in Path(config.docs_dir).glob("*.md") for path in _OUTSIDE.findall(page.read_text())}
    for path in sorted(outside):
        files.append(File.generated(config, f"files/{path}", content=(_ROOT / path).read_bytes()))
    return files


def on_page_markdown(markdown: str, page: Page, config: MkDocsConfig, files: Files) -> str:
    """Turns links out of this folder to the copies that the site has."""
    return markdown if page.file.src_uri.startswith("reference/") else _OUTSIDE.sub(r"](files/\1", markdown)


def reference_pages() -> dict[str, str]:
    """Markdown of the reference by file name."""
    openapi = json.loads((_ROOT / "api" / "rest" / "openapi.json").read_text())
    return {"python.md": python_page(), "rest.md": rest_page(openapi), "grpc.md": grpc_page(_proto_files())}


def python_page() -> str:
    """Markdown by which mkdocstrings shows the public names of the three packages."""
    parts = ["# Python", "What the packages export. Shapes, units and errors stand with each name."]
    for package in ("fastsplat", "fastsplat_client", "fastsplat_contract"):
        folder = _ROOT / "client" / package
        modules = sorted(
            ".".join(path.relative_to(folder).with_suffix("").parts)
            for path in folder.rglob("*.py")
            if not path.stem.startswith(("_", "client")) and "_pb2" not in path.stem
        )
        parts += [f"## {package}", f"::: {package}", "    options: {show_root_heading: false}"]
        if package == "fastsplat_contract":
            for module in modules:
                parts += [
                    f"### {package}.{module}",
                    f"::: {package}.{module}",
                    "    options: {show_root_heading: false}",
                ]
    return "\n\n".join(parts).replace("\n\n    options", "\n    options") + "\n"


def rest_page(openapi: Mapping[str, Any]) -> str:
    """Markdown of an OpenAPI document: its operations by path, then its types."""
    lines = ["# REST", openapi["info"].get("description", ""), "## Operations"]
    for path, item in openapi["paths"].items():
        for method in _METHODS:
            if method in item:
                lines += _operation(method, path, item[method])
    lines += ["## Types"]
    for name, schema in sorted(openapi["components"]["schemas"].items()):
        lines += [f"### {name} {{ #{_anchor(name)} }}", _text(schema.get("description", ""))]
        lines += _properties(schema)
    return "\n\n".join(line for line in lines if line) + "\n"


def _operation(method: str, path: str, operation: Mapping[str, Any]) -> Iterator[str]:
    yield f"### {method.upper()} `{path}` {{ #{_anchor(operation['operationId'])} }}"
    yield f"**{operation['summary']}**" if "summary" in operation else ""
    yield _text(operation.get("description", ""))
    if parameters := operation.get("parameters", ()):
        rows = [
            (
                f"`{parameter['name']}`",
                parameter["in"],
                _type(parameter.get("schema", {})),
                _optional(parameter),
                _text(parameter.get("description", "")),
            )
            for parameter in parameters
        ]
        yield _table(("parameter", "in", "type", "", ""), rows)
    for kind, content in operation.get("requestBody", {}).get("content", {}).items():
        yield f"Body, `{kind}`: {_type(content.get('schema', {}))}"
    rows = []
    for status, response in operation.get("responses", {}).items():
        kinds = [
            f"`{kind}` {_type(body.get('schema', {}))}".strip() for kind, body in response.get("content", {}).items()
        ]
        rows.append((status, _text(response.get("description", "")), "<br>".join(kinds)))
    yield _table(("status", "", "answer"), rows)


def _properties(schema: _Schema) -> Iterator[str]:
    if "enum" in schema:
        yield "One of " + ", ".join(f"`{value}`" for value in schema["enum"]) + "."
    required = schema.get("required", ())
    rows = [
        (f"`{name}`", _type(field), "" if name in required else "optional", _text(field.get("description", "")))
        for name, field in schema.get("properties", {}).items()
    ]
    if rows:
        yield _table(("field", "type", "", ""), rows)


def _type(schema: _Schema) -> str:
    """A schema in a few words, with links to the types of this page."""
    if "$ref" in schema:
        name = schema["$ref"].rpartition("/")[2]
        return f"[{name}](#{_anchor(name)})"
    for several in ("anyOf", "oneOf", "allOf"):
        if several in schema:
            return " or ".join(dict.fromkeys(_type(option) for option in schema[several]))
    if "enum" in schema or "const" in schema:
        return " or ".join(f"`{value}`" for value in schema.get("enum", [schema.get("const")]))
    kind = schema.get("type", "")
    if kind == "array":
        items = [*schema.get("prefixItems", ())] or [schema.get("items") or {}]
        return "list of " + ", ".join(dict.fromkeys(_type(item) for item in items))
    if kind == "object" and isinstance(more := schema.get("additionalProperties"), Mapping):
        return f"map to {_type(more)}"
    name = kind if isinstance(kind, str) else " or ".join(kind)
    return f"{name} ({schema['format']})" if "format" in schema else name


def _optional(parameter: Mapping[str, Any]) -> str:
    return "" if parameter.get("required") else "optional"


def _proto_files() -> Sequence[FileDescriptorProto]:
    bundled = Path(grpc_tools.__file__).parent / "_proto"
    with tempfile.TemporaryDirectory() as folder:
        described = Path(folder, "protos")
        arguments = ["protoc", f"-I{_ROOT / 'protos'}", f"-I{bundled}", "--include_source_info"]
        status = protoc.main([*arguments, f"--descriptor_set_out={described}", *_PROTOS])
        if status:
            raise SystemExit(status)
        return FileDescriptorSet.FromString(described.read_bytes()).file


def grpc_page(files: Sequence[FileDescriptorProto]) -> str:
    """Markdown of proto files with their comments: services, messages, enums."""
    lines = ["# gRPC"]
    for file in files:
        said = {tuple(place.path): _comment(place) for place in file.source_code_info.location}
        lines += [f"## {file.package}: `{file.name}`", said.get((12,), "")]  # 12: what stands before `syntax`
        for index, service in enumerate(file.service):
            lines += [f"### service {service.name}", said.get((6, index), "")]
            for number, method in enumerate(service.method):
                request, response = _link(method.input_type), _link(method.output_type)
                request = f"stream of {request}" if method.client_streaming else request
                response = f"stream of {response}" if method.server_streaming else response
                lines += [f"#### {method.name}", f"{request} → {response}", said.get((6, index, 2, number), "")]
        for index, message in enumerate(file.message_type):
            lines += _message(message, (4, index), said)
        for index, enum in enumerate(file.enum_type):
            lines += _enum(enum, (5, index), said)
    return "\n\n".join(line for line in lines if line) + "\n"


def _message(message: DescriptorProto, path: tuple[int, ...], said: Mapping[tuple[int, ...], str]) -> Iterator[str]:
    yield f"### {message.name} {{ #{_anchor(message.name)} }}"
    yield said.get(path, "")
    rows = [
        (str(field.number), f"`{field.name}`", _field_type(field, message), _text(said.get((*path, 2, number), "")))
        for number, field in enumerate(message.field)
    ]
    if rows:
        yield _table(("", "field", "type", ""), rows)
    for number, enum in enumerate(message.enum_type):
        yield from _enum(enum, (*path, 4, number), said)


def _enum(enum: EnumDescriptorProto, path: tuple[int, ...], said: Mapping[tuple[int, ...], str]) -> Iterator[str]:
    yield f"### {enum.name} {{ #{_anchor(enum.name)} }}"
    yield said.get(path, "")
    rows = [
        (str(value.number), f"`{value.name}`", _text(said.get((*path, 2, number), "")))
        for number, value in enumerate(enum.value)
    ]
    yield _table(("", "value", ""), rows)


def _field_type(field: FieldDescriptorProto, message: DescriptorProto) -> str:
    entry = next(
        (inner for inner in message.nested_type if field.type_name.endswith(f".{message.name}.{inner.name}")), None
    )
    if entry is not None and entry.options.map_entry:
        key, value = (_field_type(part, entry) for part in entry.field)
        return f"map of {key} to {value}"
    if field.type_name:
        name = _link(field.type_name)
    else:
        name = FieldDescriptorProto.Type.Name(field.type).removeprefix("TYPE_").lower()
    if field.label == FieldDescriptorProto.LABEL_REPEATED:
        return f"list of {name}"
    if field.HasField("oneof_index") and not field.proto3_optional:
        return f"{name}, one of `{message.oneof_decl[field.oneof_index].name}`"
    return f"optional {name}" if field.proto3_optional else name


def _link(type_name: str) -> str:
    package, _, name = type_name.removeprefix(".").rpartition(".")
    return f"[{name}](#{_anchor(name)})" if package == "fastsplat.v1" else f"`{package}.{name}`"


def _comment(place: Any) -> str:
    """What stands before a declaration, and behind it."""
    return "\n".join(part.strip("\n") for part in (place.leading_comments, place.trailing_comments) if part.strip())


def _anchor(name: str) -> str:
    return re.sub(r"[^a-z0-9_-]", "-", name.lower())


def _text(text: str) -> str:
    """On one line, safe in a table."""
    return " ".join(text.split()).replace("|", "\\|").replace("<", "&lt;")


def _table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)
