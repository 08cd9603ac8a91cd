"""Whether a finished scene can be made anew without some of its photos."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from typing import Any

from fastsplat.service.capture.formats.kept_capture import kept_labels
from fastsplat.service.capture.photos.scene_photos import photo_folder
from fastsplat_contract.errors import InvalidInputError, NotReadyError

FEWEST_LEFT = 2
"""Photos that a scene is made of at least."""


def photos_left(names: Sequence[str], withdrawn: Collection[str]) -> tuple[str, ...]:
    """The photos of a scene that are left, in their order.

    Args:
        names: of all that are kept.
        withdrawn: of those that go.

    Raises:
        InvalidInputError: no photo is named, one twice, one that is not kept, or too few would be left.
    """
    if not withdrawn:
        raise InvalidInputError("no photos", field="photos", hint="Name the photos that are to go.")
    for number, name in enumerate(withdrawn):
        if name not in names:
            raise InvalidInputError(
                f"the scene has no photo {name[:80]!r}",
                field=f"photos[{number}]",
                hint="List the scene's photos; views of a panorama are named one by one.",
            )
    if len(set(withdrawn)) < len(withdrawn):
        raise InvalidInputError("a photo is named twice", field="photos", hint="Name each photo once.")
    left = tuple(name for name in names if name not in withdrawn)
    if len(left) < FEWEST_LEFT:
        raise InvalidInputError(
            f"{len(left)} of {len(names)} photos would be left",
            field="photos",
            limit=f"at least {FEWEST_LEFT} photos that stay",
            hint="Delete the scene.",
        )
    return left


def check_retrainable(quality: Mapping[str, Any], folder: Path) -> None:
    """Raise unless the scene of a version can be made anew of what is kept with it.

    Args:
        quality: of the scene.
        folder: of its current version.

    Raises:
        NotReadyError: no photos are kept with it, or no label maps where its labels came with the capture; or it is a
            splat of another tool, of which nobody knows what it was trained on.
    """
    hint = "Delete the scene, and post the other photos again."
    if quality.get("splat"):
        raise NotReadyError(
            "the Gaussians of this scene came as a file, and nobody knows which photos they were trained on",
            field="scene",
            hint=hint,
        )
    if not any(photo_folder(folder).glob("*.jpg")):
        raise NotReadyError("no photos are kept with this scene", field="scene", hint=hint)
    if quality.get("label_source") == "given" and kept_labels(photo_folder(folder)) is None:
        raise NotReadyError("the label maps of this scene are not kept with it", field="scene", hint=hint)
