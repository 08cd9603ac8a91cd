"""The sample scene of the package, `service.store.sample_scene`, for a while: in a folder, or as a `LocalScene`."""

from __future__ import annotations

import shutil
import tempfile
import weakref
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from fastsplat.service.library.local_scene import LocalScene, open_scene
from fastsplat.service.store.sample_scene import unpack_sample


@contextmanager
def sample_folder() -> Iterator[Path]:
    """The data folder of a service with the sample scene, of temporary files: gone with all edits when the block ends.

    Raises:
        ResourceError, InvalidInputError: as `unpack_sample`.
    """
    with tempfile.TemporaryDirectory(prefix="fastsplat-sample-", ignore_cleanup_errors=True) as place:
        unpack_sample(Path(place) / "data")
        yield Path(place) / "data"


def open_sample() -> LocalScene:
    """The sample scene: a table with things on it, in meters. Edits are gone when it is closed.

    Raises:
        ResourceError, InvalidInputError: as `unpack_sample`.
    """
    place = Path(tempfile.mkdtemp(prefix="fastsplat-sample-"))
    try:
        unpack_sample(place / "data")
        scene = open_scene(place / "data")
    except BaseException:
        shutil.rmtree(place, ignore_errors=True)
        raise
    scene.on_close(weakref.finalize(scene, shutil.rmtree, place, ignore_errors=True))
    return scene
