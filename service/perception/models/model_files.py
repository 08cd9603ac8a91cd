"""The files of a model's folder by the part they play, checked when they are opened against the digest that the
manifest or the receipt of the pull knows: a network whose bits have flipped mostly opens, and answers something
else."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path

from fastsplat.service.perception.models.model_manifest import load_manifest
from fastsplat.service.perception.onnx_session import file_sha256
from fastsplat_contract.errors import ModelUnavailableError

RECEIPT = "pulled.json"
"""What a pull writes into a model's folder: the digests of its files."""


def only_network(folder: Path, *, name: str) -> Path:
    """The one `.onnx` or `.ort` file of a model that is one network.

    Raises:
        ModelUnavailableError: none, or several; or it does not have its digest.
    """
    return _only(_networks(folder), folder, name, "network (.onnx or .ort)")


def encoder_and_decoder(folder: Path, *, name: str) -> tuple[Path, Path]:
    """The two networks of a segmenter, the decoder known by "decoder" in the file's name.

    Raises:
        ModelUnavailableError: not exactly one of each; or one does not have its digest.
    """
    networks = [path for path in _networks(folder) if path != _batch_decoder(folder)]
    decoders = [path for path in networks if "decoder" in path.name]
    encoders = [path for path in networks if path not in decoders]
    return _only(encoders, folder, name, "encoder"), _only(decoders, folder, name, "decoder")


def image_and_text(folder: Path, *, name: str) -> tuple[Path, Path]:
    """The two networks of an image-text model, that of texts known by "text" in the file's name.

    Raises:
        ModelUnavailableError: not exactly one of each; or one does not have its digest.
    """
    texts = [path for path in _networks(folder) if "text" in path.name]
    images = [path for path in _networks(folder) if path not in texts]
    return _only(images, folder, name, "network of images"), _only(texts, folder, name, 'network of texts ("text")')


def batch_decoder(folder: Path, *, name: str) -> Path | None:
    """The decoder of a segmenter that takes many prompts at once, known by "decoder_batch" in the file's name; None
    where a model has none.

    Raises:
        ModelUnavailableError: it does not have its digest.
    """
    path = _batch_decoder(folder)
    return None if path is None else _checked(path, name)


def tokenizer(folder: Path, *, name: str) -> Path:
    """The `tokenizer.json` of a text encoder, which may be missing.

    Raises:
        ModelUnavailableError: it does not have its digest.
    """
    return _checked(folder / "tokenizer.json", name)


def known_digests(folder: Path, *, name: str) -> Mapping[str, str]:
    """Hex sha256 by file name, as far as it is known, of a model's files: by the manifest and the pull's receipt.

    Args:
        name: as a setting names the model; "adapter:folder" is in no manifest.

    Raises:
        ModelUnavailableError: the receipt is damaged.
    """
    entry = next((entry for entry in load_manifest() if entry.name == name), None)
    digests = {file.name: file.sha256 for file in (entry.files if entry else ()) if file.sha256}
    receipt = folder / RECEIPT
    if receipt.is_file():
        try:
            digests |= json.loads(receipt.read_text("utf-8"))["sha256"]
        except (ValueError, KeyError, TypeError) as error:
            raise _damaged(receipt, name) from error
    return digests


def only_table(folder: Path, *, name: str) -> Path:
    """The one `.npz` file of a label table.

    Raises:
        ModelUnavailableError: none, or several; or it does not have its digest.
    """
    return _only(sorted(folder.glob("*.npz")), folder, name, "label table (.npz)")


def checked_file(path: Path, *, name: str) -> Path:
    """The same path, of a file of a model that may be missing.

    Raises:
        ModelUnavailableError: it does not have its digest.
    """
    return _checked(path, name)


def _batch_decoder(folder: Path) -> Path | None:
    return next((path for path in _networks(folder) if "decoder_batch" in path.name), None)


def _checked(path: Path, name: str) -> Path:
    digest = known_digests(path.parent, name=name).get(path.name)
    if digest and path.is_file() and file_sha256(path) != digest:
        raise _damaged(path, name)
    return path


def _damaged(path: Path, name: str) -> ModelUnavailableError:
    return ModelUnavailableError(
        f"model {name}: {path.name} is damaged: its bytes are not those that were pulled",
        field=name,
        hint=f'Run "fastsplat models pull {name}" again. A model of your own belongs into a folder of its own name.',
    )


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
    return _checked(paths[0], name)
