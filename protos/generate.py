"""Regenerates the Python of the .proto files: `python protos/generate.py [output folder]`."""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

import grpc_tools
from grpc_tools import protoc

_ROOT = Path(__file__).resolve().parent
_PROTOS = ("fastsplat/v1/fastsplat.proto", "fastsplat/v1/status.proto")
OUTPUT = _ROOT.parent / "client/fastsplat_contract/v1"
"""The package that the generated modules belong to: `fastsplat_contract.v1`."""

GENERATED = (
    "fastsplat_pb2.py",
    "fastsplat_pb2.pyi",
    "fastsplat_pb2_grpc.py",
    "fastsplat_pb2_grpc.pyi",
    "status_pb2.py",
    "status_pb2.pyi",
)
"""What `generate` writes."""


def generate(output: Path) -> None:
    """Write `GENERATED` into `output` (needs grpcio-tools and mypy-protobuf beside this interpreter)."""
    scripts = Path(sys.executable).parent
    bundled = Path(grpc_tools.__file__).parent / "_proto"
    plugins = [f"--plugin=protoc-gen-{kind}={scripts / f'protoc-gen-{kind}'}" for kind in ("mypy", "mypy_grpc")]
    with tempfile.TemporaryDirectory() as folder:
        outs = [f"--{kind}_out={folder}" for kind in ("python", "grpc_python", "mypy", "mypy_grpc")]
        status = protoc.main(["protoc", f"-I{_ROOT}", f"-I{bundled}", *plugins, *outs, *_PROTOS])
        if status != 0:
            raise SystemExit(status)
        for name in GENERATED:
            # protoc imports modules by the proto file's folder; ours are in a package of another name.
            text = Path(folder, "fastsplat/v1", name).read_text()
            text = text.replace("from fastsplat.v1 import", "from fastsplat_contract.v1 import")
            text = text.replace("fastsplat.v1.fastsplat_pb2", "fastsplat_contract.v1.fastsplat_pb2")
            (output / name).write_text(text)


if __name__ == "__main__":
    generate(Path(sys.argv[1]) if len(sys.argv) > 1 else OUTPUT)
