"""Drafts of a scene, assembled as every scene is, of less: a few views, and masks at a smaller size."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from fastsplat.service.capture.types import Capture
from fastsplat.service.common.progress import silent
from fastsplat.service.perception.types import Labelling
from fastsplat.service.pipeline import Provenance, assemble_scene, scene_quality
from fastsplat.service.scene.drafts import draft_of
from fastsplat.service.scene.types import Scene
from fastsplat.service.settings import Settings
from fastsplat.service.splatting.early_splats import point_splats
from fastsplat.service.splatting.types import TrainedSplats
from fastsplat_contract.job_watching import Provisional

_SIDE = 320
_ROUNDS = 1


def point_draft(capture: Capture, labelling: Labelling, views: Sequence[int], settings: Settings) -> Scene:
    """A scene of the capture's points, with what was seen in some views.

    Args:
        capture: registered images.
        labelling: as far as it has come.
        views: numbers of the views that it knows.
        settings: of all rooms, with the preset applied.

    Raises:
        FastSplatError: as `assemble_scene`.
    """
    splats = point_splats(capture, labelling.learnt(), views, settings.training)
    return training_draft(splats, capture, labelling, views, settings, Provisional("points", 0.0))


def training_draft(
    splats: TrainedSplats,
    capture: Capture,
    labelling: Labelling,
    views: Sequence[int],
    settings: Settings,
    provisional: Provisional,
) -> Scene:
    """A scene of Gaussians as they are; arguments as for `point_draft`.

    Args:
        splats: the Gaussians.
        capture, labelling, views, settings: as for `point_draft`.
        provisional: what the draft is made of.

    Raises:
        FastSplatError: as `assemble_scene`.
    """
    chosen, masks = set(views), labelling.masks
    known = tuple(mask if number in chosen else None for number, mask in enumerate(masks))
    if not any(mask is not None for mask in known):
        known = ()
    discovery = settings.discovery.model_copy(
        update={
            "max_side": min(_SIDE, settings.discovery.max_side),
            "refinement_rounds": min(_ROUNDS, settings.discovery.refinement_rounds),
            **({} if known else {"things": "off"}),  # nobody looks for masks meanwhile
        }
    )
    early = settings.model_copy(update={"discovery": discovery})
    labelled = replace(labelling, masks=known)
    quality = scene_quality(splats, labelled, capture, Provenance())
    return draft_of(assemble_scene(splats, labelled, capture, early, quality, silent), provisional)
