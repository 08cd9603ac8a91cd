"""How a splat of another tool becomes a scene."""

from __future__ import annotations

from pydantic import Field

from fastsplat.service.common.settings import Options, SettingGroup


class SplatImportOptions(Options):
    """How pictures of a splat are rendered."""

    picture_side: int = Field(640, ge=64, le=4_096)
    """Pixels of their longer side; the shorter is three quarters of it."""
    code_steps: int = Field(100, ge=0)
    """Steps in which the codes of an imported splat are optimized, geometry and color held. On the sample's splat with
    exact label maps, mean IoU in test views: evidence alone 0.945, codes of the most probable class 0.945, after 60
    steps 0.963, after 200 0.968; the scene trained with its labels has 0.966. More steps cost the masks of Gaussians
    some of theirs: 0.959 on evidence, 0.957 after 60 steps, 0.907 after 200 (trained 0.848)."""


class SplatImportSettings(SplatImportOptions, SettingGroup, section="splat_import"):
    """How a splat of another tool becomes a scene."""

    pictures: int = Field(28, ge=2, le=500)
    """Pictures that are rendered around a splat without posed photos."""
