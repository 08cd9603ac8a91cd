"""Writes arrays as safetensors files."""

from __future__ import annotations

import os
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from numpy.typing import NDArray
from safetensors import SafetensorError
from safetensors.numpy import save_file


def write_arrays(arrays: Mapping[str, NDArray[Any]], path: Path) -> None:
    """Writes contiguous arrays to `path`; equal arrays give equal bytes.

    Raises:
        OSError: the disk is full or not writable; translated from a `SafetensorError`, whose text has the errno.
    """
    try:
        save_file(dict(arrays), path)
    except SafetensorError as error:
        code = re.search(r"\(os error (\d+)\)", str(error))
        if code is None:
            raise
        raise OSError(int(code[1]), os.strerror(int(code[1])), str(path)) from error
