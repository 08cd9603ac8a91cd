"""The bundled trained sample scene, for queries without photos, training and network.

`sample_scene.zip` is a backup of a data folder (`service.store.care.backup`) with one scene, trained from `demo/sample`
(`make sample-scene`). Its PLY file, half of all bytes, is left out and written again from the same Gaussians, bit for
bit, as the restoration checks.
"""

from __future__ import annotations

import lzma
import tempfile
import zipfile
from pathlib import Path

from fastsplat.service.scene.artefact.scene_files import read_scene
from fastsplat.service.scene.formats.ply import write_ply
from fastsplat_contract.errors import InvalidInputError, ResourceError, SceneFileError

SAMPLE_ARCHIVE = Path(__file__).with_name("sample_scene.zip")
PLY_NAME = "scene.ply"
"""Left out of the archive; lies beside each version's `artefact` folder."""


def unpack_sample(folder: Path) -> None:
    """Makes an empty or missing folder a data folder with the sample scene.

    Raises:
        ConflictError: the folder is not empty.
        ResourceError: the disk is full, or the archive is not installed.
        InvalidInputError: the archive is damaged.
    """
    from fastsplat.service.store.care.backup import restore  # imported only if a sample is opened

    if not SAMPLE_ARCHIVE.is_file():
        raise ResourceError(
            "the sample scene is not installed",
            field="sample",
            hint="Install fastsplat again; in a checkout: make sample-scene.",
        )
    with tempfile.TemporaryDirectory(prefix="fastsplat-sample-") as work:
        try:
            with zipfile.ZipFile(SAMPLE_ARCHIVE) as archive:
                archive.extractall(work)
            for artefact in Path(work).glob("files/scenes/*/*/artefact"):
                write_ply(read_scene(artefact).gaussians, artefact.with_name(PLY_NAME))
        except (zipfile.BadZipFile, lzma.LZMAError, EOFError, SceneFileError) as error:
            raise InvalidInputError(
                "the sample scene is damaged", field="sample", hint="Install fastsplat again."
            ) from error
        except OSError as error:
            raise ResourceError(
                f"the sample scene cannot be unpacked: {error.strerror}",
                field="sample",
                hint="Free space in the folder for temporary files, or name another one by TMPDIR.",
            ) from error
        restore(Path(work), folder, "")
