"""Draft scenes: assembled like any scene, from few views and smaller masks.

Things are found and named, but not described or read, which took more than half of a draft's time.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from fastsplat.service.capture.captures import Capture
from fastsplat.service.common.progress import silent
from fastsplat.service.jobs.create_scene import Provenance, assemble_scene, scene_quality
from fastsplat.service.perception.results import Labelling
from fastsplat.service.scene.artefact.draft_marks import draft_of
from fastsplat.service.scene.artefact.scene import Scene
from fastsplat.service.settings import Settings
from fastsplat.service.splatting.results import TrainedSplats
from fastsplat.service.splatting.training.train import train
from fastsplat_contract.jobs.job_watching import Provisional

_SIDE = 320
_ROUNDS = 1
_FIRST = {"iterations": 200, "max_side": 240, "max_gaussians": 10_000}
"""Training of about 1 s: untrained points hide small smooth things, which have few."""


def first_draft(capture: Capture, labelling: Labelling, views: Sequence[int], settings: Settings) -> Scene:
    """Builds a briefly trained scene from the capture's points and the views labelled so far."""
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
    """Builds a draft from the current Gaussians; other arguments and errors as for `first_draft`."""
    chosen, masks = set(views), labelling.masks
    known = tuple(mask if number in chosen else None for number, mask in enumerate(masks))
    if not any(mask is not None for mask in known):
        known = ()
    discovery = settings.discovery.model_copy(
        update={
            "max_side": min(_SIDE, settings.discovery.max_side),
            "refinement_rounds": min(_ROUNDS, settings.discovery.refinement_rounds),
            **({} if known else {"things": "off"}),  # no mask proposals for drafts
        }
    )
    early = settings.model_copy(update={"discovery": discovery})
    labelled = replace(labelling, masks=known)
    quality = scene_quality(splats, labelled, capture, Provenance())
    scene = assemble_scene(splats, labelled, capture, early, quality, described=False)
    return draft_of(scene, provisional)
