"""Opens temporary copies of the bundled sample scene."""

from __future__ import annotations

import shutil
import tempfile
import weakref
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from fastsplat.service.library.local_scene import LocalScene, open_scene
from fastsplat.service.store.care.sample_scene import unpack_sample


@contextmanager
def sample_folder() -> Iterator[Path]:
    """Yields a temporary data folder with the sample scene, deleted afterwards.

    Raises:
        ResourceError, InvalidInputError: as `unpack_sample`.
    """
    with tempfile.TemporaryDirectory(prefix="fastsplat-sample-", ignore_cleanup_errors=True) as place:
        unpack_sample(Path(place) / "data")
        yield Path(place) / "data"


def open_sample() -> LocalScene:
    """Opens the sample scene, a table with objects on it, in meters; edits are temporary.

    Examples:
        >>> with open_sample() as scene:
        ...     scene.info.scale, scene.info.gaussians, len(scene.views)
        ('METRIC', 13827, 26)

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
