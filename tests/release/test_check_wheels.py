"""What `make dist` refuses before it installs anything: wheels that would not run elsewhere, or lack a part."""

from __future__ import annotations

import os
import sys
import zipfile
from contextlib import nullcontext
from pathlib import Path

import pytest

from release.check_wheels import check_page, free_ports, interpreter_of, wheels_of, without_local_addresses

_PRODUCT = "fastsplat-1.0-cp311-cp311-manylinux_2_34_x86_64.whl"
_CLIENT = "fastsplat_client-1.0-py3-none-any.whl"
_PAGE, _KERNELS = "fastsplat/api/web/dist/index.html", "fastsplat/service/splatting/raster/_cpu.cpython-311.so"


def wheels(folder: Path, product: str = _PRODUCT, holds: tuple[str, ...] = (_PAGE, _KERNELS), client: str = "") -> Path:
    """A folder of two wheels, the product's with these files, the client's with one module and `client`."""
    for name, files in ((product, holds), (_CLIENT, ("fastsplat_client/client.py", client))):
        with zipfile.ZipFile(folder / name, "w") as wheel:
            for file in filter(None, files):
                wheel.writestr(file, "")
    return folder


def test_a_pair_that_is_whole_is_taken(tmp_path: Path) -> None:
    later = _PRODUCT.replace("cp311", "cp312")
    products, client = wheels_of(wheels(wheels(tmp_path), later))
    assert ([product.name for product in products], client.name) == ([_PRODUCT, later], _CLIENT)
    assert [interpreter_of(product) for product in products] == ["python3.11", "python3.12"]


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"product": _PRODUCT.replace("manylinux_2_34", "linux")}, "0 manylinux wheels"),
        ({"holds": (_KERNELS,)}, "index"),
        ({"holds": (_PAGE,)}, "_cpu"),
        ({"client": "fastsplat_client/fast.so"}, "fast.so"),
    ],
)
def test_what_would_not_run_elsewhere_is_refused(tmp_path: Path, changes: dict, said: str) -> None:
    with pytest.raises(SystemExit, match=said):
        wheels_of(wheels(tmp_path, **changes))


def test_two_releases_in_one_folder_are_refused(tmp_path: Path) -> None:
    wheels(tmp_path, _PRODUCT.replace("1.0", "2.0"))
    with pytest.raises(SystemExit, match="2 manylinux wheels of the product for 1 interpreters"):
        wheels_of(wheels(tmp_path))


def test_the_bill_has_digests_in_place_of_files_of_this_machine() -> None:
    digest, page = {"alg": "SHA-256", "content": "ab"}, {"type": "website", "url": "https://numpy.org"}
    built = {"name": "fastsplat", "externalReferences": [{"url": "file:///made/a.whl", "hashes": [digest]}]}
    fetched = {"name": "numpy", "externalReferences": [page]}
    assert without_local_addresses({"components": [built, fetched]})["components"] == [
        {"name": "fastsplat", "externalReferences": [], "hashes": [digest]},
        fetched,
    ]


def test_a_page_counts_only_with_all_that_it_names(tmp_path: Path) -> None:
    names = '<script src="web/a.js">'
    for page, files, refused in ((names, ["a.js"], ""), (names, [], "404"), ("not built", [], "names no files")):
        served = tmp_path / f"page {refused}"
        (served / "web").mkdir(parents=True)
        (served / "index.html").write_text(page)
        for file in files:
            (served / "web" / file).touch()
        (port,) = free_ports(1)
        command = [sys.executable, "-m", "http.server", str(port), "-b", "127.0.0.1", "-d", str(served)]
        with pytest.raises((SystemExit, OSError), match=refused) if refused else nullcontext():
            check_page(command, dict(os.environ), tmp_path, f"http://127.0.0.1:{port}")
