"""Settings of the query package: how texts are compared with a dictionary, and how answers become images."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import AfterValidator, Field

from fastsplat.service.common.setting_groups import Options, SettingGroup


def _one_slot(template: str) -> str:
    if template.count("{}") != 1:
        raise ValueError(f"the template {template!r} needs exactly one {{}}")
    return template


class QueryOptions(Options):
    """How texts are scored, and what one request may hold."""

    negatives: Annotated[tuple[str, ...], Field(min_length=1)] = ("object", "things", "stuff", "texture")
    """Canonical negatives (LERF)."""
    temperature: Annotated[float, Field(ge=0, allow_inf_nan=False)] | None = None
    """t of the pairwise softmax (LERF). None takes the encoder's calibrated one, by which relevancy comes nearest to a
    probability, or LERF's 10 for an encoder without."""
    templates: Annotated[tuple[Annotated[str, AfterValidator(_one_slot)], ...], Field(min_length=1)] = (
        "{}",
        "a photo of a {}",
    )
    """Sentences a name is put into before it is embedded; a name's embedding is the mean over them, of unit length.
    Measured for MiniLM by benchmarks/calibration."""
    score: Literal["similarity", "relevancy"] = "similarity"
    """What orders the entries and is compared with the encoder's threshold. LERF's relevancy subtracts from each entry
    its own likeness to the canonical negatives, which for text against text reorders entries for the worse (measured
    by benchmarks/calibration); it is reported either way."""
    coverage: Annotated[float, Field(gt=0, lt=1)] = 0.9
    """Share of questions whose label set is to hold an acceptable answer."""
    max_sentences: Annotated[int, Field(ge=0)] = 8_192
    """Labels times templates that one request may have embedded anew."""
    max_poses: int = 64
    """Cameras and named views of one request."""
    cached_texts: Annotated[int, Field(ge=0)] = 4_096
    """Embeddings of recent texts that are kept, per encoder; shared by the scenes of a server."""
    alpha_min: Annotated[float, Field(ge=0, le=1)] = 0.5
    """Pixels less covered than this belong to no mask and have no depth."""
    surface_views: Annotated[int, Field(ge=1)] = 48
    """Cameras of a scene, at most, from which the surfaces of a point cloud or a mesh are taken."""
    surface_side: Annotated[int, Field(ge=16)] = 480
    """Pixels of the longer side of those views."""


class QuerySettings(QueryOptions, SettingGroup, section="query"):
    """How a text is compared with the dictionary, and how an answer becomes an image."""

    threshold: float | None = None
    """From this score an entry counts as related; None takes the encoder's calibrated threshold. For `relevancy` the
    score is the margin d·q − max_j d·c_j, which is 0 where the relevancy is 0.5, at any temperature."""
    exact_threshold: float | None = None
    """From this score an entry counts as the object itself; None takes the encoder's calibrated threshold."""
    backend: Literal["reference", "cpu", "cuda"] = "cpu"
    """Rasterizer that draws views; `reference` is the slow one that the others are tested against."""
    max_surface_voxels: Annotated[int, Field(ge=8)] = 8_000_000
    """Voxels that a mesh is made of; as with points."""
    map_height: Annotated[float, Field(gt=0.25, allow_inf_nan=False)] = 1.5
    """Meters above the floor up to which what stands there is in a robot's way, and where its eye is."""
