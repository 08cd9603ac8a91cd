"""Models required for new scenes, and those missing from the model directory."""

from __future__ import annotations

import logging

from fastsplat.service.settings import Settings
from fastsplat_contract.errors import ModelUnavailableError

logger = logging.getLogger(__name__)


def missing_models(settings: Settings, *, given_labels: bool = False, named: bool = False) -> list[str]:
    """Lists missing models with their settings; `named`: the request names labels."""
    from fastsplat.service.perception.models.model_manifest import Role, has_files  # loads with the first upload

    perception, roles = settings.perception, list[Role](("text_encoder",))
    masks = settings.discovery.proposes(given_labels=given_labels)
    prompted = bool(perception.open_set_detector)
    if masks or not given_labels:
        roles.append("segmenter")
    if masks if given_labels else not prompted or (perception.prompt_source == "closed_set" and not named):
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
