"""Files of a model's folder by role, checked against known digests on opening.

Networks with flipped bits mostly open, and answer wrongly. All functions raise `ModelUnavailableError` for files that
are missing, not unique, or differ from the digest of the manifest or the pull's receipt.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

from fastsplat.service.perception.models.model_manifest import load_manifest
from fastsplat.service.perception.onnx_session import file_sha256
from fastsplat_contract.errors import ModelUnavailableError

RECEIPT = "pulled.json"
"""Written by a pull into a model's folder."""


@dataclass(frozen=True)
class Receipt:
    """What a pull noted: hex SHA-256 by file; repo, path and commit by file of a hub."""

    sha256: Mapping[str, str] = field(default_factory=dict)
    hub: Mapping[str, Mapping[str, str]] = field(default_factory=dict)


def read_receipt(folder: Path, *, name: str) -> Receipt:
    """Reads the receipt of a model; empty if nothing was pulled."""
    path = folder / RECEIPT
    try:
        stored = json.loads(path.read_text("utf-8"))
        return Receipt(dict(stored["sha256"]), dict(stored.get("hub", {})))
    except (FileNotFoundError, NotADirectoryError):
        return Receipt()
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        raise _damaged(path, name) from error


def only_network(folder: Path, *, name: str) -> Path:
    """Finds the only `.onnx` or `.ort` file of a model."""
    return _only(_networks(folder), folder, name, "network (.onnx or .ort)")


def text_network(folder: Path, *, name: str) -> Path:
    """Finds the network of a text encoder, which may be that of an image-text model."""
    return only_network(folder, name=name) if len(_networks(folder)) == 1 else image_and_text(folder, name=name)[1]


def encoder_and_decoder(folder: Path, *, name: str) -> tuple[Path, Path]:
    """Finds the two networks of a segmenter; the decoder has "decoder" in its name."""
    networks = [path for path in _networks(folder) if path != _batch_decoder(folder)]
    decoders = [path for path in networks if "decoder" in path.name]
    encoders = [path for path in networks if path not in decoders]
    return _only(encoders, folder, name, "encoder"), _only(decoders, folder, name, "decoder")


def image_and_text(folder: Path, *, name: str) -> tuple[Path, Path]:
    """Finds the networks of images and of texts ("text" in its name), or those in `visual/` and `textual/`."""
    networks = [path for inner in (".", "visual", "textual") for path in _networks(folder / inner)]
    texts = [path for path in networks if "text" in str(path.relative_to(folder))]
    images = [path for path in networks if path not in texts]
    return _only(images, folder, name, "network of images"), _only(texts, folder, name, 'network of texts ("text")')


def batch_decoder(folder: Path, *, name: str) -> Path | None:
    """Finds a segmenter's decoder for many prompts ("decoder_batch" in its name), or None."""
    path = _batch_decoder(folder)
    return None if path is None else _checked(path, name)


def tokenizer(folder: Path, *, name: str) -> Path:
    """Returns the path of a text encoder's `tokenizer.json`, which may be missing."""
    return _checked(folder / "tokenizer.json", name)


def known_digests(folder: Path, *, name: str) -> Mapping[str, str]:
    """Hex SHA-256 by file name, as far as known from manifest and receipt."""
    entry = next((entry for entry in load_manifest() if entry.name == name), None)
    digests = {file.name: file.sha256 for file in (entry.files if entry else ()) if file.sha256}
    return {**digests, **read_receipt(folder, name=name).sha256}


def installed_digests(folder: Path, *, name: str) -> Mapping[str, str]:
    """Hex SHA-256 by file name of a model that is here, read where none is known; empty if files are missing."""
    known = known_digests(folder, name=name)
    if not all((folder / file).is_file() for file in known):
        return {}
    return known or {path.name: file_sha256(path) for path in _networks(folder) or folder.glob("*.npz")}


def only_table(folder: Path, *, name: str) -> Path:
    """Finds the only `.npz` file of a label table."""
    return _only(sorted(folder.glob("*.npz")), folder, name, "label table (.npz)")


def checked_file(path: Path, *, name: str) -> Path:
    """Checks the digest of a file, which may be missing, and returns its path."""
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
