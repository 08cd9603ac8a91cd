"""`python -m demo.look`: the web page with a trained scene, without keys, on this machine alone, until Ctrl-C.

The scene is what `make demo` trained, in demo-output/service. Before that has run it is the sample scene that the
package brings, in the data folder sample-scene, which is made with the first look and keeps what is done there. The
text encoder (23 MB), which answers questions, is fetched where it is missing; without a network all else works.
"""

from __future__ import annotations

import argparse
import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

from fastsplat.service.settings import load_settings
from fastsplat.service.store.database import SQLITE_NAME
from fastsplat_contract.errors import FastSplatError

TRAINED = Path("demo-output") / "service"
"""The data folder of `make demo`."""
SAMPLE = Path("sample-scene")
"""The data folder of the sample scene."""


def main() -> None:
    """Serve the page in place of this process."""
    argparse.ArgumentParser(
        prog="python -m demo.look", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    ).parse_args()
    try:
        folder = folder_to_look_at()
    except FastSplatError as error:
        raise SystemExit(f"{error.reason}: {error.message}. {error.hint}") from error
    os.environ["FASTSPLAT_DATA_DIR"] = str(folder)
    program = Path(sys.executable).parent / "fastsplat"
    if (encoder := missing_text_encoder()) and subprocess.run([program, "models", "pull", encoder]).returncode != 0:
        print(f"{encoder} could not be fetched, see above: questions are not answered, all else works", flush=True)
    print(f"{folder}: Ctrl-C ends it", flush=True)
    os.execv(program, [str(program), "serve", "--no-auth"])


def missing_text_encoder() -> str:
    """The text encoder of the settings if it is not in the model directory, else ""."""
    settings = load_settings()
    encoder = settings.perception.text_encoder
    return "" if (settings.models / encoder).is_dir() else encoder


def folder_to_look_at() -> Path:
    """The data folder of `make demo`, or that of the sample scene, which is made if it is not there yet.

    Raises:
        ResourceError, InvalidInputError: as `unpack_sample`.
    """
    if (TRAINED / SQLITE_NAME).is_file():
        return TRAINED
    if not (SAMPLE / SQLITE_NAME).is_file():
        from fastsplat.service.store.sample_scene import (
            unpack_sample,
        )  # loads most of the service, and is seldom needed

        unfinished = Path(tempfile.mkdtemp(prefix=f"{SAMPLE}-", dir="."))
        try:
            unpack_sample(unfinished)
            unfinished.rename(SAMPLE)  # whole or not at all
        finally:
            shutil.rmtree(unfinished, ignore_errors=True)
    return SAMPLE


if __name__ == "__main__":
    main()
