"""Models in use and required for new scenes, and those missing from the model directory."""

from __future__ import annotations

import logging
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from fastsplat.service.common.setting_groups import ModelChoice
from fastsplat.service.settings import Settings
from fastsplat_contract.errors import InvalidInputError, ModelUnavailableError

if TYPE_CHECKING:  # loads with the first upload
    from fastsplat.service.perception.models.model_manifest import ModelEntry

logger = logging.getLogger(__name__)


def in_use(settings: Settings, choice: ModelChoice) -> Settings:
    """Settings with the chosen models, except in roles whose setting is set."""
    perception = settings.perception.with_models({role: model["name"] for role, model in choice.items()})
    return settings.model_copy(update={"perception": perception})


def choice_of(entries: Sequence[ModelEntry], models: Path, *, built_in: bool) -> ModelChoice:
    """Builds a choice of models in the model directory; `built_in`: they are of the built-in manifest.

    Raises:
        InvalidInputError: two models of one role.
    """
    from fastsplat.service.perception.models.model_files import installed_digests

    choice: dict[str, Mapping[str, Any]] = {}
    for entry in entries:
        if entry.role in choice:
            raise InvalidInputError(
                f"{entry.name} and {choice[entry.role]['name']} are both models of the role {entry.role}",
                field="name",
                limit="one model a role",
                hint="Choose one of them.",
            )
        name = entry.name if built_in else f"{entry.adapter}:{entry.name}"
        known = {} if entry.conversion else installed_digests(models / entry.name, name=entry.name)
        choice[entry.role] = {"name": name, "sha256": known}  # conversions differ between machines
    return choice


def lacking(settings: Settings, choice: ModelChoice) -> Sequence[str]:
    """Lists chosen models that are not here with the chosen bytes, except where a setting overrides them."""
    from fastsplat.service.perception.models.model_files import installed_digests

    missing = []
    for role, model in choice.items():
        folder = model["name"].rpartition(":")[2]
        found = installed_digests(settings.models / folder, name=folder)
        overridden = role in settings.perception.model_fields_set
        if not overridden and not (found and model["sha256"].items() <= found.items()):
            missing.append(model["name"])
    return missing


def missing_models(settings: Settings, *, given_labels: bool = False, named: bool = False) -> list[str]:
    """Lists missing models with their settings; `named`: the request names labels."""
    from fastsplat.service.perception.models.model_manifest import (  # loads with the first upload
        Role,
        has_files,
        is_prompted_by_classes,
    )

    perception, roles = settings.perception, list[Role](("text_encoder",))
    masks = settings.discovery.proposes(given_labels=given_labels)
    prompted = bool(perception.open_set_detector)
    if masks or not given_labels:
        roles.append("segmenter")
    if masks if given_labels else not prompted or (is_prompted_by_classes(perception) and not named):
        roles.append("closed_set_detector")
    if prompted and not given_labels:
        roles.append("open_set_detector")
    names = ((role, getattr(perception, role)) for role in roles)
    return [f"{name} (perception.{role})" for role, name in names if not has_files(name, role, settings.models)]


def check_models(settings: Settings, *, given_labels: bool, named: bool) -> None:
    """Raises `ModelUnavailableError` if `missing_models` lists any."""
    if missing := missing_models(settings, given_labels=given_labels, named=named):
        raise ModelUnavailableError(
            f"a scene needs models that are not in the server's model directory: {', '.join(missing)}",
            field="models",
            hint="Run on the server: fastsplat models pull; or set FASTSPLAT_MODELS to the directory that has them.",
        )


def log_missing_models(settings: Settings) -> None:
    """Logs a warning if the model directory lacks models for new scenes."""
    if missing := missing_models(settings):
        lack = f"{settings.models} (FASTSPLAT_MODELS) lacks {', '.join(missing)}"
        logger.warning("new scenes will fail: %s; run: fastsplat models pull", lack)
