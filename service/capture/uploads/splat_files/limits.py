"""What every reader of a splat file says when it refuses one."""

from __future__ import annotations

from dataclasses import dataclass

from fastsplat_contract.errors import InvalidInputError, LimitExceededError


@dataclass(frozen=True)
class SplatLimits:
    """Bounds on a splat file.

    Attributes:
        max_gaussians: rows of one file.
        setting: the environment variable that holds it, for messages.
    """

    max_gaussians: int
    setting: str = ""


def check_count(name: str, count: int, limits: SplatLimits) -> None:
    """Raise before anything is allocated for `count` rows.

    Raises:
        LimitExceededError: more than the limit.
        InvalidInputError: none.
    """
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
    """The error of a file that is no splat, or a damaged one."""
    return InvalidInputError.of(
        name,
        problem,
        "Send a 3D Gaussian splatting PLY, a compressed PLY of SuperSplat, SPZ (version 2 to 4), SOG, .splat or "
        ".ksplat.",
    )
