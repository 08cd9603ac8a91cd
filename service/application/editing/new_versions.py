"""Rows of new versions: one function assembles them for all who make versions, so that none leaves a part out."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from typing import Any

import numpy as np

from fastsplat.service.query.things.gaussian_labels import label_gaussians
from fastsplat.service.query.things.labeled_things import things_of
from fastsplat.service.query.things.look_alikes import Sizes, sizes_in_meters
from fastsplat.service.query.things.names_by_looks import described
from fastsplat.service.scene.alignment import alignment_to_json
from fastsplat.service.scene.changes import changed_views
from fastsplat.service.scene.drafts import provisional_of
from fastsplat.service.scene.scaling import scaling_to_json
from fastsplat.service.scene.things import thing_count
from fastsplat.service.scene.types import Scene, Things
from fastsplat.service.settings import CallSettings
from fastsplat.service.store.name_repository import names_between
from fastsplat.service.store.version_repository import NewVersion


def new_version(
    scene_id: str,
    version: str,
    parent: str,
    before: Things | None,
    scene: Scene,
    limits: CallSettings,
    *,
    gaussians: int,
    things: int,
    dictionary: Sequence[Mapping[str, Any]],
    edits: Sequence[Mapping[str, Any]],
    sizes: Sizes | None = None,
    author: str = "",
    request_id: str = "",
    request_digest: str = "",
) -> NewVersion:
    """The row of a version, with all that follows from its scene.

    Args:
        scene_id, version, parent, author, request_id, request_digest, edits: see `NewVersion`.
        before: the things of the parent.
        scene: of the version.
        limits: how many versions, and names of people, are kept.
        gaussians, things, dictionary: see `content_of`.
        sizes: see `sizes_in_meters`; None: not known yet.
    """
    appearances = described(scene.things, sizes_in_meters(scene) if sizes is None else sizes)
    return NewVersion(
        scene_id=scene_id,
        version=version,
        parent=parent,
        request_id=request_id,
        request_digest=request_digest,
        gaussians=gaussians,
        dictionary=dictionary,
        edits=edits,
        things=things,
        names=names_between(before, scene.things, appearances, limits.max_known_names),
        author=author,
        scaling=scaling_to_json(scene.scaling),
        alignment=alignment_to_json(scene.alignment),
        quality={"changed_by": list(changes)} if (changes := changed_views(scene.quality)) else {},
        # All versions of a draft stay: they are made again on the scene that takes its place.
        max_versions=None if provisional_of(scene.quality) else limits.max_versions,
    )


def content_of(scene: Scene) -> dict[str, Any]:
    """What stands in a version's row of what it holds: "gaussians" and "things", their numbers, and "dictionary", its
    rows by label id."""
    counts = np.bincount(label_gaussians(scene).classes, minlength=len(scene.dictionary) + 1)
    dictionary = [
        {"label_id": number, **asdict(entry), "gaussian_count": int(counts[number])}
        for number, entry in enumerate(scene.dictionary.entries, start=1)
    ]
    return {"gaussians": len(scene.gaussians), "things": thing_count(things_of(scene)), "dictionary": dictionary}
