"""A server with a trained scene, as the pages of the documentation presuppose one."""

from __future__ import annotations

import json
import os
import shutil
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest

import fastsplat
from fastsplat.cli.demo.service_process import running_service
from fastsplat.service.store.care.sample_scene import unpack_sample
from fastsplat_client import Client
from release.check_wheels import free_ports
from tests.docs.forks import forks
from tests.docs.page_blocks import ROOT
from tests.docs.page_reader import PageReader

_BIN = Path(sys.executable).parent
_VIEWS = 8
_SMALL = {  # keeps the trainings of the pages short; readers have the defaults
    "FASTSPLAT_TRAINING__ITERATIONS": "40",
    "FASTSPLAT_TRAINING__TIME_BUDGET_S": "600",  # the iterations are over before
    "FASTSPLAT_TRAINING__MAX_GAUSSIANS": "6000",
    "FASTSPLAT_TRAINING__MAX_SIDE": "160",
    "FASTSPLAT_TRAINING__MAX_SH_DEGREE": "1",
    "FASTSPLAT_DISCOVERY__OBJECTS": "off",
    "FASTSPLAT_SPLAT_IMPORT__PICTURES": "4",
    "FASTSPLAT_JOBS__POLL_INTERVAL_S": "0.2",
    "FASTSPLAT_JOBS__NICENESS": "0",  # a busy machine would hardly get to it
}


@dataclass(frozen=True)
class Home:
    """A server as a reader has it."""

    data_dir: Path
    scene_id: str
    trained: str
    key: str
    ports: dict[int, int]
    environment: dict[str, str]

    @property
    def url(self) -> str:
        """Of REST and the page."""
        return f"http://localhost:{self.ports[8000]}"


@pytest.fixture(scope="package")
def small_environment(models_dir: Path) -> Iterator[dict[str, str]]:
    """Variables of a process whose trainings are short, with the default models; this process has them, too."""
    with pytest.MonkeyPatch.context() as patch:
        for name in [name for name in os.environ if name.startswith("FASTSPLAT_")]:
            patch.delenv(name)
        for name, value in {**_SMALL, "FASTSPLAT_MODELS": str(models_dir), "OMP_WAIT_POLICY": "passive"}.items():
            patch.setenv(name, value)
        patch.setenv("PATH", str(_BIN), prepend=os.pathsep)
        yield dict(os.environ)


@pytest.fixture(scope="package")
def programs(small_environment: dict[str, str], tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """A folder whose `fastsplat` begins with its imports done."""
    with forks(tmp_path_factory.mktemp("forks")) as folder:
        yield folder


@pytest.fixture(scope="package")
def photos(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Some of the sample's photos with their poses and label maps: a capture that trains in seconds."""
    source, target = ROOT / "demo" / "sample", tmp_path_factory.mktemp("capture") / "photos"
    document = json.loads((source / "transforms.json").read_text())
    document["frames"] = document["frames"][:: len(document["frames"]) // _VIEWS][:_VIEWS]
    del document["instances"]
    for frame in document["frames"]:
        del frame["instance_path"]
        for path in (frame["file_path"], frame["mask_path"]):
            (target / path).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy(source / path, target / path)
    (target / "transforms.json").write_text(json.dumps(document))
    return target


@pytest.fixture(scope="package")
def home(small_environment: dict[str, str], tmp_path_factory: pytest.TempPathFactory) -> Iterator[Home]:
    """`fastsplat serve` over a data folder with one scene, which every page begins with."""
    data_dir = tmp_path_factory.mktemp("home") / "fastsplat-data"
    unpack_sample(data_dir)
    with fastsplat.open_scene(data_dir) as scene:
        scene_id, trained = scene.id, scene.info.version
    ports = dict(zip((8000, 8001), free_ports(2), strict=True))
    with running_service(
        data_dir=data_dir,
        models=Path(small_environment["FASTSPLAT_MODELS"]),
        log=data_dir.with_name("serve.log"),
        http_port=ports[8000],
        grpc_port=ports[8001],
    ) as key:
        environment = {**small_environment, "SCENE": scene_id, "FASTSPLAT_KEY": key}
        yield Home(data_dir, scene_id, trained, key, ports, environment)


@pytest.fixture
def new_reader(home: Home, photos: Path, programs: Path, tmp_path: Path) -> Iterator[Callable[[str], PageReader]]:
    """Makes a reader in a folder like a checkout, before a server whose only scene is as it was trained."""
    readers: list[PageReader] = []

    def make(name: str) -> PageReader:
        folder = tmp_path / name
        folder.mkdir()
        for entry in ("client", "demo", "docs", "Makefile"):
            (folder / entry).symlink_to(ROOT / entry)
        (folder / ".venv").mkdir()
        (folder / ".venv" / "bin").symlink_to(_BIN)
        (folder / "fastsplat-data").symlink_to(home.data_dir)
        shutil.copytree(photos, folder / "photos")
        readers.append(PageReader(folder, home.environment, home.ports, programs))
        return readers[-1]

    try:
        yield make
    finally:
        for reader in readers:
            reader.close()
        with Client(home.url, key=home.key) as client:
            for scene in list(client.scenes()):
                if scene.id != home.scene_id:
                    client.delete_scene(scene.id)
            if client.scene(home.scene_id).version != home.trained:
                client.restore_version(home.scene_id, home.trained)
