"""Excludes photos of a validated upload by name."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import replace

from fastsplat.service.capture.formats.upload_manifest import UploadManifest
from fastsplat.service.common.file_names import list_names
from fastsplat_contract.errors import InvalidInputError

ON_REQUEST = "left out on request"  # the reason in the manifest
_FEWEST_WITHOUT_POSES = 2
_FIELD = "exclude"


def photo_paths(manifest: UploadManifest, names: Sequence[str]) -> tuple[str, ...]:
    """Resolves names of photos or views to paths in the upload.

    Raises:
        InvalidInputError: the upload has no such photo, or no photos at all, as a video.
    """
    paths = {name: photo.path for photo, name in zip(manifest.photos, manifest.names, strict=True)}
    paths |= {photo.path: photo.path for photo in manifest.photos}
    paths |= {path: path for path in manifest.left_out}  # not used anyway
    unknown = [name[:80] for name in names if name not in paths]
    if unknown:
        raise InvalidInputError(
            f"the upload has no photo {list_names(unknown)}",
            field=_FIELD,
            hint="Name photos as in the upload, or as the error and the photos' verdicts name them."
            if manifest.photos
            else "Only photos can be left out, and it has none.",
        )
    return tuple(dict.fromkeys(paths[name] for name in names))


def without_photos(manifest: UploadManifest, paths: Collection[str]) -> UploadManifest:
    """Moves photos to the manifest's `left_out`; raises `InvalidInputError` if too few stay."""
    gone = [photo.path for photo in manifest.photos if photo.path in paths]
    rest = [
        (photo, name) for photo, name in zip(manifest.photos, manifest.names, strict=True) if photo.path not in paths
    ]
    fewest = 1 if manifest.poses else _FEWEST_WITHOUT_POSES
    if gone and len(rest) < fewest:
        raise InvalidInputError(
            f"without {len(gone)} of {len(manifest.photos)} photos only {len(rest)} would be left",
            field=_FIELD,
            limit=f"at least {fewest} photos",
            hint="Leave out fewer, or post other photos.",
        )
    return replace(
        manifest,
        photos=tuple(photo for photo, _ in rest),
        names=tuple(name for _, name in rest),
        left_out={**manifest.left_out, **dict.fromkeys(gone, ON_REQUEST)},
    )
