"""Shared refusals of splat files."""

from __future__ import annotations

from dataclasses import dataclass

from fastsplat_contract.errors import InvalidInputError, LimitExceededError


@dataclass(frozen=True)
class SplatLimits:
    """Limits of a splat file; `setting` is the environment variable, for messages."""

    max_gaussians: int
    setting: str = ""


def check_count(name: str, count: int, limits: SplatLimits) -> None:
    """Checks a row count before any allocation: at least 1, at most the limit."""
    if count > limits.max_gaussians:
        setting = f" ({limits.setting})" if limits.setting else ""
        raise LimitExceededError.of(
            name,
            f"announces {count} Gaussians",
            "Reduce the splat in an editor, or raise the limit.",
            f"{limits.max_gaussians} Gaussians{setting}",
        )
    if count < 1:
        raise bad_splat(name, "has no Gaussians")


def bad_splat(name: str, problem: str) -> InvalidInputError:
    """Makes the error of a damaged or foreign file."""
    return InvalidInputError.of(
        name,
        problem,
        "Send a 3D Gaussian splatting PLY, a compressed PLY of SuperSplat, SPZ (version 2 to 4), SOG, .splat or "
        ".ksplat.",
    )
