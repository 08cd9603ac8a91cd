"""Make the environment that this Python belongs to smaller: `python slim.py`, with binutils, the product installed.

What goes is read by nothing at run time: headers, test programs and tests of libraries, symbols for debuggers,
bytecode of modules that the product never imports. Every module of the product and every package that it depends on
is imported in the end, which fails where something is gone that was needed, and writes the bytecode of what is used.
"""

import importlib
import pkgutil
import re
import shutil
import subprocess
import sys
from importlib.metadata import packages_distributions, requires
from pathlib import Path

_TESTED = ("networkx", "numpy", "scipy", "sympy")
"""Packages whose folders `tests` hold tests alone; torch's `testing` and numpy's are read by other modules."""

_SCRIPTS = ("fastsplat.service.store.rows.migrations.env",)
"""Alembic runs it; nothing imports it."""


def main(site: Path) -> None:
    """Slim the `site-packages` folder `site`."""
    torch = site / "torch"
    unread = [torch / "include", torch / "test", *site.rglob("__pycache__"), *site.rglob("*.a")]
    unread += [path for path in (torch / "bin").iterdir() if path.name != "torch_shm_manager"]
    unread += [path for name in _TESTED for path in (site / name).rglob("tests")]
    unread += (site / "onnxruntime/capi").glob("libonnxruntime.so*")  # for C; Python's module has all of it in itself
    for path in unread:
        if path.is_dir():
            shutil.rmtree(path)
        else:
            path.unlink(missing_ok=True)
    for library in site.rglob("*.so*"):
        # Libraries in *.libs were moved by auditwheel; they do not load any more once strip has rewritten them.
        if not library.is_symlink() and not library.parent.name.endswith(".libs"):
            subprocess.run(["strip", "--strip-unneeded", library], check=True)
    _import_all()


def _import_all() -> None:
    needed = {_distribution(line) for line in requires("fastsplat") or () if "extra ==" not in line}
    optional = {_distribution(line) for line in requires("fastsplat") or ()} - needed
    for name, distributions in packages_distributions().items():
        if needed & {_distribution(distribution) for distribution in distributions} and name.isidentifier():
            importlib.import_module(name)
    for module in pkgutil.walk_packages(importlib.import_module("fastsplat").__path__, "fastsplat."):
        if module.name not in _SCRIPTS and not module.name.endswith(".__main__"):
            try:
                importlib.import_module(module.name)
            except ModuleNotFoundError as error:
                if not any(name.split("-")[0] == error.name for name in optional):
                    raise


def _distribution(requirement: str) -> str:
    found = re.match(r"[\w.-]+", requirement)
    assert found, requirement
    return re.sub(r"[-_.]+", "-", found[0]).lower()


if __name__ == "__main__":
    main(Path(sys.prefix) / f"lib/python{sys.version_info.major}.{sys.version_info.minor}/site-packages")
