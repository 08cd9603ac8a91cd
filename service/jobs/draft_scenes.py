"""Drafts of a scene, assembled as every scene is, of less: a few views, and masks at a smaller size.

Things are found and named; what they look like, and what is written on them, took more than half of a draft's time.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from fastsplat.service.capture.captures import Capture
from fastsplat.service.common.progress import silent
from fastsplat.service.jobs.pipeline import Provenance, assemble_scene, scene_quality
from fastsplat.service.perception.results import Labelling
from fastsplat.service.scene.artefact.drafts import draft_of
from fastsplat.service.scene.artefact.scene import Scene
from fastsplat.service.settings import Settings
from fastsplat.service.splatting.results import TrainedSplats
from fastsplat.service.splatting.training.train import train
from fastsplat_contract.jobs.job_watching import Provisional

_SIDE = 320
_ROUNDS = 1
_FIRST = {"iterations": 200, "max_side": 240, "max_gaussians": 10_000}
"""The training of the first draft, a second long: on bare points small smooth things, which have few, are not found."""


def first_draft(capture: Capture, labelling: Labelling, views: Sequence[int], settings: Settings) -> Scene:
    """A scene of the capture's points, trained for a moment, with what was seen in some views.

    Args:
        capture: registered images.
        labelling: as far as it has come.
        views: numbers of the views that it knows.
        settings: of all rooms, with the preset applied.

    Raises:
        FastSplatError: as `train` and `assemble_scene`.
    """
    bounds = {**_FIRST, "time_budget_s": None, "evaluations": 0, "held_out_every": 0}
    splats = train(capture, labelling.learnt(), settings.training.model_copy(update=bounds), silent)
    return training_draft(splats, capture, labelling, views, settings, Provisional("points", 0.0))


def training_draft(
    splats: TrainedSplats,
    capture: Capture,
    labelling: Labelling,
    views: Sequence[int],
    settings: Settings,
    provisional: Provisional,
) -> Scene:
    """A scene of Gaussians as they are; arguments as for `first_draft`.

    Args:
        splats: the Gaussians.
        capture, labelling, views, settings: as for `first_draft`.
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
    scene = assemble_scene(splats, labelled, capture, early, quality, described=False)
    return draft_of(scene, provisional)
