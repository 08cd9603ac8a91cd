"""Do the wheels install and run where there is neither compiler nor Node.js? `python release/check_wheels.py FOLDER`.

For each interpreter that FOLDER has a product's wheel for, in a new virtual environment with nothing else on the path,
it installs that wheel and the client's, trains the sample by `fastsplat demo --train`, and fetches the page and all
that it names from `fastsplat serve`. What was installed is written beside the wheels (`sbom.cdx.json`, CycloneDX, and
`licenses.md`; the page brings its own, `licenses.txt`). It needs these interpreters, the registry that pip is set to,
and default models as `fastsplat models pull` finds or fetches them. Prints the sizes that documents say.
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
from typing import Any

_ROOT = Path(__file__).parents[1]
_PATIENCE_S = 300.0
_TRAINING_S = "60"
"""Seconds of the training: whether it runs is what is asked, and not how good it gets."""


def main(folder: Path) -> None:
    """Ends with an error where anything does not hold."""
    products, client = wheels_of(folder)
    for wheel in (*products, client):
        print(f"{wheel.name}: {wheel.stat().st_size / 1e6:.1f} MB")
    for product in products:
        check(product, client, folder)
    print("the wheels install, train and serve the page")


def check(product: Path, client: Path, folder: Path) -> None:
    """Install, train and serve by the interpreter that `product` is for, and write what it brings into `folder`."""
    with tempfile.TemporaryDirectory(prefix="fastsplat-wheels-") as directory:
        place = Path(directory)
        tools = place / "environment" / "bin"
        subprocess.run([interpreter_of(product), "-m", "venv", tools.parent], check=True)
        port, grpc_port = free_ports(2)
        environment = {**os.environ, "PATH": str(tools), "FASTSPLAT_METRICS_PORT": "0"}
        environment |= {"FASTSPLAT_HTTP_PORT": str(port), "FASTSPLAT_GRPC_PORT": str(grpc_port)}
        environment.pop("VIRTUAL_ENV", None)
        environment.pop("PYTHONPATH", None)

        def run(*command: str | Path) -> None:
            subprocess.run([tools / command[0], *command[1:]], env=environment, cwd=place, check=True)

        wheels, pins = (product.absolute(), client.absolute()), ("--constraint", _ROOT / "constraints.txt")
        run("pip", "install", "--quiet", "--only-binary", ":all:", *pins, *wheels)
        print(f"{product.name}: installed with all that it needs, {bytes_of(tools.parent) / 1e9:.1f} GB", flush=True)
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


def interpreter_of(product: Path) -> str:
    """The command of the CPython that a product's wheel is for."""
    return f"python3.{re.findall(r'-cp3([0-9]+)-', product.name)[0]}"


def write_contents(python: Path, folder: Path) -> None:
    """Write what the environment of this interpreter has, and under which licences, into `folder`."""
    listed = folder / "sbom.cdx.json"
    bill = ["cyclonedx_py", "environment", "--output-reproducible", "--output-file", str(listed), str(python)]
    subprocess.run([sys.executable, "-m", *bill], check=True)
    options = ["--format=markdown", "--from=mixed", "--with-urls", f"--output-file={folder / 'licenses.md'}"]
    subprocess.run([Path(sys.executable).with_name("pip-licenses"), f"--python={python}", *options], check=True)
    told_of = without_local_addresses(json.loads(listed.read_text()))
    listed.write_text(json.dumps(told_of, indent=2) + "\n")
    names = {component["name"] for component in told_of["components"]}
    if not {"fastsplat", "fastsplat-client", "torch"} <= names:
        raise SystemExit(f"{listed} lacks what was installed")
    print(f"{listed.name}: {len(names)} packages")


def without_local_addresses(bill: dict[str, Any]) -> dict[str, Any]:
    """A CycloneDX bill in which what was installed from a file keeps the file's digests, and not its place here."""
    for component in bill["components"]:
        references = component.get("externalReferences", [])
        local = [reference for reference in references if reference["url"].startswith("file:")]
        if local:
            component["externalReferences"] = [reference for reference in references if reference not in local]
            component["hashes"] = [digest for reference in local for digest in reference.get("hashes", [])]
    return bill


def wheels_of(folder: Path) -> tuple[list[Path], Path]:
    """The product's wheels, one for each interpreter, and the client's, the only one.

    Raises:
        SystemExit: another number of wheels, a product's that runs only on the machine that built it or has no page or
            kernels, a client's with anything compiled.
    """
    products = sorted(folder.glob("fastsplat-[0-9]*-manylinux_*.whl"))
    clients = sorted(folder.glob("fastsplat_client-*-py3-none-any.whl"))
    interpreters = {interpreter_of(product) for product in products}
    if not products or len(interpreters) != len(products) or len(clients) != 1:
        raise SystemExit(
            f"{folder} has {len(products)} manylinux wheels of the product for {len(interpreters)} interpreters, where "
            f"each has one, and {len(clients)} of the client, where one is needed"
        )
    for product in products:
        names = _names(product)
        for needed in (r"fastsplat/api/web/dist/index\.html", r"fastsplat/service/splatting/raster/_cpu.*\.so"):
            if not any(re.fullmatch(needed, name) for name in names):
                raise SystemExit(f"{product.name} has no {needed}")
    if compiled := [name for name in _names(clients[0]) if name.endswith((".so", ".pyd"))]:
        raise SystemExit(f"{clients[0].name} has {compiled}")
    return products, clients[0]


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


def _names(wheel: Path) -> list[str]:
    with zipfile.ZipFile(wheel) as opened:
        return opened.namelist()


def _fetched(address: str) -> str:
    with urllib.request.urlopen(address) as answer:
        return str(answer.read().decode(errors="replace"))


if __name__ == "__main__":
    main(Path(sys.argv[1]))
