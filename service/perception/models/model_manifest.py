"""The model manifest, `manifest.toml`: roles, adapters, licenses, files and sources."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from functools import cache
from pathlib import Path, PurePosixPath
from typing import Annotated, Literal, TypeVar

from pydantic import BaseModel, ConfigDict, Field, StringConstraints, ValidationError, model_validator

from fastsplat_contract.errors import ModelUnavailableError

Role = Literal[
    "text_encoder", "closed_set_detector", "open_set_detector", "segmenter", "tagger", "lexicon", "reader", "image_text"
]
Adapter = Literal[
    "sentence", "clip", "label_table", "picodet", "grounding_dino", "owlv2", "owlvit", "yolo_world", "sam1", "sam2",
    "ram", "wordnet", "ppocr",
]  # fmt: skip

ROLES: Mapping[Role, tuple[Adapter, ...]] = {
    "text_encoder": ("sentence", "clip", "label_table"),
    "closed_set_detector": ("picodet",),
    "open_set_detector": ("grounding_dino", "owlv2", "owlvit", "yolo_world"),
    "segmenter": ("sam1", "sam2"),
    "tagger": ("ram",),
    "lexicon": ("wordnet",),
    "reader": ("ppocr",),
    "image_text": ("clip",),
}
"""Adapters of each role."""

T = TypeVar("T")

_Sha256 = Annotated[str, StringConstraints(pattern=r"^[0-9a-f]{64}$")]
_Revision = Annotated[str, StringConstraints(pattern=r"^[0-9a-f]{40}$")]

BUILT_IN_MANIFEST = Path(__file__).parent / "manifest.toml"

PERMISSIVE = frozenset(
    {"Apache-2.0", "MIT", "BSD-2-Clause", "BSD-3-Clause", "ISC", "CC0-1.0", "CC-BY-4.0", "LicenseRef-WordNet"}
)
"""Licenses (SPDX) that `pull` accepts by default; WordNet's allows any use with its notice."""


class _Frozen(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid")


class LocalSource(_Frozen):
    """A file on this machine; relative paths start at the manifest's folder."""

    kind: Literal["local"]
    path: Path


class HubSource(_Frozen):
    """A file of a Hugging Face repository; without a revision, the caller must give one."""

    kind: Literal["huggingface"]
    repo: str
    path: str
    revision: _Revision | None = None


class PackageSource(_Frozen):
    """A file inside a PyPI (wheel or source) or npm package; `sha256` is the archive's."""

    kind: Literal["pypi", "npm"]
    package: str
    version: str
    path: str
    sha256: _Sha256


Source = Annotated[LocalSource | HubSource | PackageSource, Field(discriminator="kind")]


class ModelFile(_Frozen):
    """A file of a model or for its conversion; sources are tried in order."""

    name: Annotated[str, StringConstraints(pattern=r"^[A-Za-z0-9][A-Za-z0-9._-]*$")]
    size: int | None = None
    sha256: _Sha256 | None = None
    sources: tuple[Source, ...] = ()


class Conversion(_Frozen):
    """Conversion of carrier files, verified by SHA-256, to model files.

    The result differs in bytes between machines, so its adapter's contract and an exercise verify it.
    """

    kind: Literal["paddle", "mobile_sam"]
    carriers: tuple[ModelFile, ...]
    packages: tuple[Annotated[str, StringConstraints(pattern=r"^[A-Za-z0-9_.-]+==[0-9.]+$")], ...] = ()
    """Pinned packages for the conversion alone, without dependencies, in a temporary folder."""


class ModelEntry(_Frozen):
    """A model of the manifest."""

    name: str  # also its folder in the model directory
    role: Role
    adapter: Adapter
    license: str  # SPDX name, of the weights
    about: str
    default: bool = False  # fetched by a `pull` without names
    files: tuple[ModelFile, ...]  # in its folder; those without sources come from `conversion`
    conversion: Conversion | None = None

    @model_validator(mode="after")
    def _adapter_plays_the_role(self) -> ModelEntry:
        if self.adapter not in ROLES[self.role]:
            known = ", ".join(ROLES[self.role])
            raise ValueError(f"the {_spoken(self.role)} {self.name} has the adapter {self.adapter}, not one of {known}")
        return self

    @property
    def permissive(self) -> bool:
        return self.license in PERMISSIVE


class _Manifest(_Frozen):
    model: tuple[ModelEntry, ...]


@cache
def load_manifest(path: Path | None = None) -> tuple[ModelEntry, ...]:
    """Loads a manifest (None: the built-in one); a damaged one raises `ModelUnavailableError`."""
    path = path or BUILT_IN_MANIFEST
    try:
        entries = _Manifest.model_validate(tomllib.loads(path.read_text("utf-8"))).model
    except (OSError, tomllib.TOMLDecodeError, ValidationError) as error:
        raise ModelUnavailableError(f"{path} is not a model manifest: {error}", field="manifest") from error
    names = [entry.name for entry in entries]
    if len(set(names)) != len(names):
        raise ModelUnavailableError(f"{path} names a model twice", field="manifest")
    return entries


def find_model(name: str, role: Role) -> tuple[Adapter, PurePosixPath]:
    """Finds a model's adapter and folder by manifest entry or "adapter:folder".

    Raises:
        ModelUnavailableError: no such entry, or one of another role.
    """
    prefix, separator, folder = name.partition(":")
    if separator:
        inside = folder not in ("", ".", "..") and "/" not in folder and "\\" not in folder
        for adapter in ROLES[role]:
            if adapter == prefix and inside:
                return adapter, PurePosixPath(folder)
        raise ModelUnavailableError(
            f'"{name}" names no {_spoken(role)}',
            field=f"perception.{role}",
            hint=f"Write adapter:folder with one of the adapters {', '.join(ROLES[role])} and a folder of the models.",
        )
    for entry in load_manifest():
        # The network of texts of an image-text model is a text encoder by itself.
        if entry.name == name and role in (entry.role, "text_encoder" if entry.role == "image_text" else ""):
            return entry.adapter, PurePosixPath(entry.name)
    known_names = ", ".join(entry.name for entry in load_manifest() if entry.role == role)
    choices = f"one of {known_names}, or adapter:folder" if known_names else f"{ROLES[role][0]}:folder"
    raise ModelUnavailableError(
        f'the manifest has no {_spoken(role)} called "{name}"',
        field=f"perception.{role}",
        hint=f"Choose {choices} for your own.",
    )


def has_files(name: str, role: Role, models: Path) -> bool:
    """Whether a model of the role that a setting names has files in the model directory."""
    try:
        folder = models / find_model(name, role)[1]
        return folder.is_dir() and any(folder.iterdir())
    except (ModelUnavailableError, OSError):
        return False


def select_adapter(adapters: Mapping[Adapter, T], adapter: Adapter, name: str, role: Role) -> T:
    """Looks up an adapter's class or function; an unknown one raises `ModelUnavailableError`."""
    if adapter not in adapters:
        raise ModelUnavailableError(
            f"model {name}: no {_spoken(role)} has the adapter {adapter}",
            field=f"perception.{role}",
            hint=f"Choose a model with one of the adapters {', '.join(adapters)}.",
        )
    return adapters[adapter]


def _spoken(role: Role) -> str:
    return role.replace("_", " ")
