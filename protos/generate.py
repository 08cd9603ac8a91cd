"""Writes the .proto from the contract's types, and the Python of the .proto: `python -m protos.generate`."""

from __future__ import annotations

import tempfile
from pathlib import Path

import grpc_tools
from grpc_tools import protoc

from protos.proto_text import proto_text
from protos.registry import Registry

_ROOT = Path(__file__).resolve().parent
_PROTOS = ("fastsplat/v1/fastsplat.proto", "fastsplat/v1/status.proto")
PROTO = _ROOT / "fastsplat/v1/fastsplat.proto"
"""What `write_proto` writes."""
NUMBERS = _ROOT / "fastsplat/v1/numbers.json"
"""The number of every field and enum value that ever was."""
OUTPUT = _ROOT.parent / "client/fastsplat_contract/v1"
"""The package that the generated modules belong to: `fastsplat_contract.v1`."""

GENERATED = (
    "fastsplat_pb2.py",
    "fastsplat_pb2.pyi",
    "status_pb2.py",
    "status_pb2.pyi",
)
"""What `generate` writes."""


def write_proto() -> None:
    """Write `PROTO`, and into `NUMBERS` what is new."""
    registry = Registry(NUMBERS)
    PROTO.write_text(proto_text(PROTO.with_suffix(".proto.in").read_text(), registry))
    registry.save()


def generate(output: Path) -> None:
    """Write `GENERATED` into `output` (needs grpcio-tools)."""
    bundled = Path(grpc_tools.__file__).parent / "_proto"
    with tempfile.TemporaryDirectory() as folder:
        outs = [f"--{kind}_out={folder}" for kind in ("python", "pyi")]
        status = protoc.main(["protoc", f"-I{_ROOT}", f"-I{bundled}", *outs, *_PROTOS])
        if status != 0:
            raise SystemExit(status)
        for name in GENERATED:
            # protoc imports modules by the proto file's folder; ours are in a package of another name.
            text = Path(folder, "fastsplat/v1", name).read_text()
            text = text.replace("from fastsplat.v1 import", "from fastsplat_contract.v1 import")
            text = text.replace("fastsplat.v1.fastsplat_pb2", "fastsplat_contract.v1.fastsplat_pb2")
            (output / name).write_text(text)


if __name__ == "__main__":
    write_proto()
    generate(OUTPUT)
