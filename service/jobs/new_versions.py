"""Rows of new versions, assembled in one place so that none is incomplete."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

import numpy as np

from fastsplat.service.query.things.gaussian_labels import label_gaussians
from fastsplat.service.query.things.labeled_things import things_of
from fastsplat.service.query.things.names.look_alikes import Sizes, sizes_in_meters
from fastsplat.service.query.things.names.names_by_looks import described
from fastsplat.service.scene.artefact.alignment import alignment_to_json
from fastsplat.service.scene.artefact.changes import changed_views
from fastsplat.service.scene.artefact.scaling import scaling_to_json
from fastsplat.service.scene.artefact.scene import Scene, Things, provisional_of
from fastsplat.service.scene.objects.things import thing_count
from fastsplat.service.settings import CallSettings
from fastsplat.service.store.repositories.name_repository import names_between
from fastsplat.service.store.repositories.version_repository import NewVersion


def new_version(
    before: Things | None, scene: Scene, limits: CallSettings, sizes: Sizes | None = None, **row: Any
) -> NewVersion:
    """Builds the row of a version, with all values derived from its scene.

    Args:
        before: things of the parent version.
        limits: maximum numbers of versions and of names given by people.
        sizes: see `sizes_in_meters`; None: computed here.
        row: remaining fields of `NewVersion`: author, parent, edits, `content_of`.
    """
    appearances = described(scene.things, sizes_in_meters(scene) if sizes is None else sizes)
    changed = list(changed_views(scene.quality))
    return NewVersion(
        names=names_between(before, scene.things, appearances, limits.max_known_names),
        scaling=scaling_to_json(scene.scaling),
        alignment=alignment_to_json(scene.alignment),
        quality={"changed_by": changed} if changed else {},
        # All versions of a draft are kept, to be reapplied to the scene that replaces it.
        max_versions=None if provisional_of(scene.quality) else limits.max_versions,
        **row,
    )


def content_of(scene: Scene, counts: Sequence[int] | None = None) -> dict[str, Any]:
    """Content columns of a version's row; `counts` are Gaussians per label, if known."""
    if counts is None:
        counts = np.bincount(label_gaussians(scene).classes, minlength=len(scene.dictionary) + 1).tolist()
    dictionary = [
        {"label_id": number, **asdict(entry), "gaussian_count": counts[number]}
        for number, entry in enumerate(scene.dictionary.entries, start=1)
    ]
    return {"gaussians": len(scene.gaussians), "things": thing_count(things_of(scene)), "dictionary": dictionary}
