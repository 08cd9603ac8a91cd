"""A full disk is an OSError, whoever writes."""

from __future__ import annotations

import errno
import resource
import signal
from pathlib import Path

import numpy as np
import pytest

from fastsplat.service.common.array_files import write_arrays


def test_an_end_of_the_disk_is_the_systems_own_error(tmp_path: Path) -> None:
    """A bound on the size of a file stands for the disk's end."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (10_000, before[1]))
    try:
        with pytest.raises(OSError, match="large") as caught:
            write_arrays({"a": np.zeros(10_000, np.float32)}, tmp_path / "a.safetensors")
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    assert caught.value.errno == errno.EFBIG and signal.getsignal(signal.SIGXFSZ) == signal.SIG_IGN
