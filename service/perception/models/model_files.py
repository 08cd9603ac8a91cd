"""The files of a model's folder by the part they play."""

from __future__ import annotations

from pathlib import Path

from fastsplat_contract.errors import ModelUnavailableError


def only_network(folder: Path, *, name: str) -> Path:
    """The one `.onnx` or `.ort` file of a model that is one network.

    Raises:
        ModelUnavailableError: none, or several.
    """
    return _only(_networks(folder), folder, name, "network (.onnx or .ort)")


def encoder_and_decoder(folder: Path, *, name: str) -> tuple[Path, Path]:
    """The two networks of a segmenter, the decoder known by "decoder" in the file's name.

    Raises:
        ModelUnavailableError: not exactly one of each.
    """
    networks = [path for path in _networks(folder) if path != batch_decoder(folder)]
    decoders = [path for path in networks if "decoder" in path.name]
    encoders = [path for path in networks if path not in decoders]
    return _only(encoders, folder, name, "encoder"), _only(decoders, folder, name, "decoder")


def batch_decoder(folder: Path) -> Path | None:
    """The decoder of a segmenter that takes many prompts at once, known by "decoder_batch" in the file's name; None
    where a model has none."""
    return next((path for path in _networks(folder) if "decoder_batch" in path.name), None)


def only_table(folder: Path, *, name: str) -> Path:
    """The one `.npz` file of a label table.

    Raises:
        ModelUnavailableError: none, or several.
    """
    return _only(sorted(folder.glob("*.npz")), folder, name, "label table (.npz)")


def _networks(folder: Path) -> list[Path]:
    return sorted(path for path in folder.glob("*") if path.suffix in (".onnx", ".ort"))


def _only(paths: list[Path], folder: Path, name: str, what: str) -> Path:
    if len(paths) != 1:
        names = ", ".join(path.name for path in paths) or "none"
        raise ModelUnavailableError(
            f"model {name}: {folder} should hold one {what}; it holds {names}",
            field=name,
            hint=f'Run "fastsplat models pull {name}", or set the model directory (FASTSPLAT_MODELS).',
        )
    return paths[0]
