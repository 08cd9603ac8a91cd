"""onnxruntime sessions of models, checked against the contract of their adapter."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cache
from pathlib import Path

import onnxruntime

from fastsplat.service.common import files
from fastsplat_contract.errors import ModelUnavailableError

onnxruntime.disable_telemetry_events()  # photos and their times are private

Shape = Sequence[int | None]
"""Sizes; None: any. A size that the model leaves open fits every number."""

Contract = tuple[Mapping[str, Shape], Mapping[str, Shape]]
"""Inputs and outputs by name."""


_CUDA = "CUDAExecutionProvider"
_providers = ["CPUExecutionProvider"]


def use_backend(backend: str) -> None:
    """Opens sessions from now on where training runs.

    That is on the GPU for "cuda", if this onnxruntime can, else on the CPU.
    """
    on_gpu = backend == "cuda" and _CUDA in onnxruntime.get_available_providers()
    _providers[:] = [*([_CUDA] if on_gpu else []), "CPUExecutionProvider"]


def open_session(path: Path, *, name: str, threads: int = 0, inner: Sequence[str] = ()) -> onnxruntime.InferenceSession:
    """Opens a session of an `.onnx` or `.ort` file, see `use_backend`.

    Args:
        threads: of one run; 0: all cores.
        inner: inner values of an `.onnx` network that become outputs after its own.

    Raises:
        ModelUnavailableError: names model and file: missing, no model, or without these inner values.
    """
    if not path.is_file():
        raise ModelUnavailableError(
            f"model {name}: there is no file {path}",
            field=name,
            hint=f'Run "fastsplat models pull {name}", or set the model directory (FASTSPLAT_MODELS).',
        )
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = threads
    options.log_severity_level = 3
    # Memory is planned for every input shape anew, and prompts vary in number: without plans a segmenter's decoder
    # takes a sixth less CPU time and 0.6 instead of 1.0 GB, its encoder 0.4 instead of 0.7 GB.
    options.enable_mem_pattern = False
    # Waiting threads sleep, as a server also trains and answers.
    options.add_session_config_entry("session.intra_op.allow_spinning", "0")
    try:
        model = path.read_bytes() + _outputs(inner) if inner else str(path)
        return onnxruntime.InferenceSession(model, options, providers=_providers)
    except Exception as error:  # onnxruntime raises a dozen unrelated types for a file it cannot read
        raise ModelUnavailableError(
            f"model {name}: {path.name} is damaged or not an ONNX model ({str(error).splitlines()[0][:200]})",
            field=name,
            hint=f'Delete the file and run "fastsplat models pull {name}" again.',
        ) from error


def check_contract(
    session: onnxruntime.InferenceSession,
    *,
    name: str,
    inputs: Mapping[str, Shape],
    outputs: Mapping[str, Shape] | Sequence[Shape],
    optional_inputs: Sequence[str] = (),
) -> None:
    """Raises `ModelUnavailableError` unless a session has these inputs and at least these outputs.

    Args:
        inputs: shape by name; no others may exist, except `optional_inputs`.
        outputs: shape by name, or shapes by position, for exporters that invent names.
    """
    if not isinstance(outputs, Mapping):
        names = [node.name for node in session.get_outputs()]
        outputs = dict(zip([*names, *map(str, range(len(outputs)))], outputs, strict=False))
    find_contract(session, {"": (inputs, outputs)}, name=name, optional_inputs=optional_inputs)


def find_contract(
    session: onnxruntime.InferenceSession,
    contracts: Mapping[str, Contract],
    *,
    name: str,
    optional_inputs: Sequence[str] = (),
) -> str:
    """Returns the name of the first contract that a session keeps; see `check_contract`."""
    has_inputs = {node.name: _shape(node.shape) for node in session.get_inputs()}
    has_outputs = {node.name: _shape(node.shape) for node in session.get_outputs()}
    wrong: dict[str, None] = {}
    for contract, (inputs, outputs) in contracts.items():
        unknown = [key for key in has_inputs if key not in inputs and key not in optional_inputs]
        failed = [*_misfits(has_inputs, inputs), *unknown, *_misfits(has_outputs, outputs)]
        if not failed:
            return contract
        wrong |= dict.fromkeys(failed)
    expected = "; or ".join(f"{_listing(inputs)} → {_listing(outputs)}" for inputs, outputs in contracts.values())
    raise ModelUnavailableError(
        f"model {name} does not keep its contract at {', '.join(wrong)}: expected {expected}; "
        f"it has {_listing(has_inputs)} → {_listing(has_outputs)}",
        field=name,
        hint="Use the model the manifest names, or choose the adapter that fits this one.",
    )


def input_side(session: onnxruntime.InferenceSession, name: str, default: int) -> int:
    """Returns the height of a session's images [N, 3, H, W], or `default` if it leaves it open."""
    side = {node.name: node.shape for node in session.get_inputs()}[name][2]
    return side if isinstance(side, int) else default


def file_sha256(path: Path) -> str:
    """Hex SHA-256 of a file, cached until another one takes its place."""
    status = path.stat()
    return _sha256(path, status.st_ino, status.st_mtime_ns, status.st_size)


@cache
def _sha256(path: Path, *state: int) -> str:
    return files.file_sha256(path)


def _outputs(names: Sequence[str]) -> bytes:
    """Encodes an ONNX model of outputs only, which protobuf merges with bytes before it.

    Fields: `ModelProto.graph` 7, `GraphProto.output` 12, `ValueInfoProto.name` 1.
    """
    return _field(7, b"".join(_field(12, _field(1, name.encode())) for name in names))


def _field(number: int, content: bytes) -> bytes:
    """Encodes a length-delimited protobuf field."""
    return _varint(number << 3 | 2) + _varint(len(content)) + content


def _varint(value: int) -> bytes:
    parts = []
    while value > 127:
        parts.append(value & 127 | 128)
        value >>= 7
    return bytes([*parts, value])


def _shape(shape: Sequence[object]) -> tuple[int | None, ...]:
    return tuple(size if isinstance(size, int) else None for size in shape)


def _misfits(has: Mapping[str, Shape], expected: Mapping[str, Shape]) -> list[str]:
    return [key for key, shape in expected.items() if key not in has or not _fits(has[key], shape)]


def _fits(shape: Shape, expected: Shape) -> bool:
    if not shape:  # an exporter that states no shape at all
        return True
    return len(shape) == len(expected) and all(
        a is None or b is None or a == b for a, b in zip(shape, expected, strict=True)
    )


def _listing(shapes: Mapping[str, Shape]) -> str:
    sizes = {key: ", ".join("?" if size is None else str(size) for size in shape) for key, shape in shapes.items()}
    return ", ".join(f"{key} [{size}]" for key, size in sizes.items())
