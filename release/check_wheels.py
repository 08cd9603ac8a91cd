"""Do the wheels install and run where there is neither compiler nor Node.js? `python release/check_wheels.py FOLDER`.

In a new virtual environment, with nothing else on the path, it installs the two wheels of FOLDER, writes what was
installed beside them (`sbom.cdx.json`, CycloneDX, and `licenses.md`; the page brings its own, `licenses.txt`), trains
the sample by `fastsplat demo --train`, and fetches the page and all that it names from `fastsplat serve`. It needs the
registry that pip is set to, and default models as `fastsplat models pull` finds or fetches them. Prints the sizes that
documents say.
"""

from __future__ import annotations

import json
import os
import re
import socket
import subprocess
import sys
import tempfile
import time
import urllib.error
import urllib.request
import zipfile
from pathlib import Path

_ROOT = Path(__file__).parents[1]
_PATIENCE_S = 300.0
_TRAINING_S = "60"
"""Seconds of the training: whether it runs is what is asked, and not how good it gets."""


def main(folder: Path) -> None:
    """Ends with an error where anything does not hold."""
    product, client = wheels_of(folder)
    for wheel in (product, client):
        print(f"{wheel.name}: {wheel.stat().st_size / 1e6:.1f} MB")
    with tempfile.TemporaryDirectory(prefix="fastsplat-wheels-") as made:
        place = Path(made)
        tools = place / "environment" / "bin"
        subprocess.run([getattr(sys, "_base_executable", sys.executable), "-m", "venv", tools.parent], check=True)
        port, other = free_ports(2)
        environment = {**os.environ, "PATH": str(tools), "FASTSPLAT_METRICS_PORT": "0"}
        environment |= {"FASTSPLAT_HTTP_PORT": str(port), "FASTSPLAT_GRPC_PORT": str(other)}
        environment.pop("VIRTUAL_ENV", None)
        environment.pop("PYTHONPATH", None)

        def run(*command: str | Path) -> None:
            subprocess.run([tools / command[0], *command[1:]], env=environment, cwd=place, check=True)

        run(
            "pip",
            "install",
            "--quiet",
            "--only-binary",
            ":all:",
            "--constraint",
            _ROOT / "constraints.txt",
            product.absolute(),
            client.absolute(),
        )
        print(f"installed with all that they need: {bytes_of(tools.parent) / 1e9:.1f} GB")
        write_contents(tools / "python", folder)
        run(
            "python",
            "-c",
            "from fastsplat.service.splatting.raster.kernels import instruction_sets as sets; "
            "print('kernels that this machine can run:', *sets())",
        )
        run("fastsplat", "demo", "--train", "--seconds", _TRAINING_S)
        environment["FASTSPLAT_DATA_DIR"] = str(place / "demo-output" / "service")
        check_page([tools / "fastsplat", "serve"], environment, place, f"http://127.0.0.1:{port}")
    print("the wheels install, train and serve the page")


def write_contents(python: Path, folder: Path) -> None:
    """Write what the environment of this interpreter has, and under which licences, into `folder`."""
    listed = folder / "sbom.cdx.json"
    bill = ["cyclonedx_py", "environment", "--output-reproducible", "--output-file", str(listed), str(python)]
    subprocess.run([sys.executable, "-m", *bill], check=True)
    told = ["--format=markdown", "--from=mixed", "--with-urls", f"--output-file={folder / 'licenses.md'}"]
    subprocess.run([Path(sys.executable).with_name("pip-licenses"), f"--python={python}", *told], check=True)
    names = {component["name"] for component in json.loads(listed.read_text())["components"]}
    if not {"fastsplat", "fastsplat-client", "torch"} <= names:
        raise SystemExit(f"{listed} lacks what was installed")
    print(f"{listed.name}: {len(names)} packages")


def wheels_of(folder: Path) -> tuple[Path, Path]:
    """The product's wheel and the client's, each the only one.

    Raises:
        SystemExit: another number of wheels, a product's that runs only on the machine that built it or has no page or
            kernels, a client's with anything compiled.
    """
    (product,) = _one(folder, "fastsplat-[0-9]*-manylinux_*.whl")
    (client,) = _one(folder, "fastsplat_client-*-py3-none-any.whl")
    with zipfile.ZipFile(product) as opened:
        names = opened.namelist()
    for needed in (r"fastsplat/api/web/dist/index\.html", r"fastsplat/service/splatting/raster/_cpu.*\.so"):
        if not any(re.fullmatch(needed, name) for name in names):
            raise SystemExit(f"{product.name} has no {needed}")
    with zipfile.ZipFile(client) as opened:
        if compiled := [name for name in opened.namelist() if name.endswith((".so", ".pyd"))]:
            raise SystemExit(f"{client.name} has {compiled}")
    return product, client


def check_page(command: list[str | Path], environment: dict[str, str], place: Path, address: str) -> None:
    """Fetch the page of a server that runs while this does, and every file that the page names.

    Raises:
        SystemExit: it ends or does not get ready, or something that the page names is not there.
    """
    server = subprocess.Popen(command, env=environment, cwd=place)
    try:
        page, until = "", time.monotonic() + _PATIENCE_S
        while not page:
            if server.poll() is not None or time.monotonic() > until:
                raise SystemExit("fastsplat serve does not get ready")
            try:
                page = _fetched(f"{address}/")
            except urllib.error.URLError:
                time.sleep(1)
        files = re.findall(r'(?:src|href)="(web/[^"]+)"', page)
        if not files:
            raise SystemExit("the page names no files: it is not built")
        for file in files:
            _fetched(f"{address}/{file}")
        print(f"the page and {len(files)} files that it names are served")
    finally:
        server.terminate()
        server.wait(_PATIENCE_S)


def free_ports(count: int) -> list[int]:
    """Ports of this machine that nobody listens at now."""
    sockets = [socket.create_server(("127.0.0.1", 0)) for _ in range(count)]
    try:
        return [opened.getsockname()[1] for opened in sockets]
    finally:
        for opened in sockets:
            opened.close()


def bytes_of(folder: Path) -> int:
    """Of all files below `folder`."""
    return sum(path.stat().st_size for path in folder.rglob("*") if path.is_file() and not path.is_symlink())


def _one(folder: Path, pattern: str) -> list[Path]:
    found = sorted(folder.glob(pattern))
    if len(found) != 1:
        raise SystemExit(f"{folder} has {len(found)} wheels {pattern}, one is needed")
    return found


def _fetched(address: str) -> str:
    with urllib.request.urlopen(address) as answer:
        return str(answer.read().decode(errors="replace"))


if __name__ == "__main__":
    main(Path(sys.argv[1]))
