"""The kernels compiled for 64-bit Arm, with NEON, and run by qemu: on one scene, every result is that of x86-64."""

from __future__ import annotations

import re
import shutil
import subprocess
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pytest

_HERE = Path(__file__).parent
_COMPILER, _EMULATOR = "aarch64-linux-gnu-g++", "qemu-aarch64"
_TOLERANCE = 1e-5  # of an array's largest value: one machine fuses multiply and add, the other rounds between them


def _built(folder: Path, *settings: str) -> Path:
    """The program that calls every kernel, with the baseline's alone."""
    folder.mkdir()
    # A processor that CMake does not know gets the baseline's kernels alone.
    options = ("-DCMAKE_BUILD_TYPE=Release", "-DCMAKE_SYSTEM_NAME=Linux", *settings)
    subprocess.run(["cmake", "-S", _HERE / "arm64", "-B", folder, *options], check=True, capture_output=True)
    subprocess.run(["cmake", "--build", folder, "--parallel", "2"], check=True, capture_output=True)
    return folder / "every_kernel"


def _results(folder: Path, *command: str | Path) -> Mapping[str, np.ndarray]:
    """What the program wrote, by the names of the results."""
    folder.mkdir()
    done = subprocess.run([*command, folder], check=True, capture_output=True, text=True)
    assert done.stdout == "baseline 4\n", done.stdout
    return {path.stem: np.fromfile(path, path.suffix[1:]) for path in sorted(folder.iterdir())}


def test_every_kernel_computes_on_arm_what_it_computes_on_x86(tmp_path: Path) -> None:
    for tool in (_COMPILER, _EMULATOR, "cmake"):
        if shutil.which(tool) is None:
            pytest.skip(f"{tool} is not here: apt-get install cmake g++-aarch64-linux-gnu qemu-user")
    here = _built(tmp_path / "here", "-DCMAKE_SYSTEM_PROCESSOR=any")
    there = _built(tmp_path / "arm", "-DCMAKE_SYSTEM_PROCESSOR=aarch64", f"-DCMAKE_CXX_COMPILER={_COMPILER}")
    fused = subprocess.run(["aarch64-linux-gnu-objdump", "-d", there], check=True, capture_output=True, text=True)
    assert len(re.findall(r"\tfmla\tv\d+\.4s", fused.stdout)) > 500, "the vectors of four floats are not NEON's"

    expected = _results(tmp_path / "x86 results", here)
    got = _results(tmp_path / "arm results", _EMULATOR, "-L", "/usr/aarch64-linux-gnu", there)
    assert got.keys() == expected.keys() and len(got) > 100
    for name, values in expected.items():
        assert got[name].shape == values.shape, name
        assert np.isfinite(values).all() and (values.any() or name == "harmonics_means_of_degree_0"), name
        if values.dtype.kind == "i":  # labels, radii and numbers of pairs
            np.testing.assert_array_equal(got[name], values, err_msg=name)
        else:
            np.testing.assert_allclose(got[name], values, rtol=0, atol=_TOLERANCE * np.abs(values).max(), err_msg=name)
