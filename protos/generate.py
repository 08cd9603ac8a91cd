"""Regenerates the Python beside `fastsplat.proto`: `python protos/generate.py [output folder]`."""

from __future__ import annotations

import sys
from pathlib import Path

import grpc_tools
from grpc_tools import protoc

_ROOT = Path(__file__).resolve().parent
_PROTO = "fastsplat/v1/fastsplat.proto"
GENERATED = tuple(
    f"fastsplat/v1/{name}"
    for name in ("fastsplat_pb2.py", "fastsplat_pb2.pyi", "fastsplat_pb2_grpc.py", "fastsplat_pb2_grpc.pyi")
)
"""What `generate` writes, relative to its output folder."""


def generate(output: Path) -> None:
    """Write `GENERATED` below `output` (needs grpcio-tools and mypy-protobuf on the PATH of this interpreter)."""
    scripts = Path(sys.executable).parent
    outs = [f"--{kind}_out={output}" for kind in ("python", "grpc_python", "mypy", "mypy_grpc")]
    plugins = [f"--plugin=protoc-gen-{kind}={scripts / f'protoc-gen-{kind}'}" for kind in ("mypy", "mypy_grpc")]
    bundled = Path(grpc_tools.__file__).parent / "_proto"
    status = protoc.main(["protoc", f"-I{_ROOT}", f"-I{bundled}", *plugins, *outs, _PROTO])
    if status != 0:
        raise SystemExit(status)


if __name__ == "__main__":
    generate(Path(sys.argv[1]) if len(sys.argv) > 1 else _ROOT)
