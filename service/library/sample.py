"""Opens temporary copies of the bundled sample scene."""

from __future__ import annotations

import tempfile
import weakref
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
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
    with ExitStack() as opened:
        scene = open_scene(opened.enter_context(sample_folder()))
        scene.on_close(weakref.finalize(scene, opened.pop_all().close))
    return scene
