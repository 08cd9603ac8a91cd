"""Files of a published version: every flipped bit is noticed, by the name of its file."""

from __future__ import annotations

import os
import random
import subprocess
from pathlib import Path

import pytest

from fastsplat.service.store.blobs.blobs import Blobs
from fastsplat.service.store.blobs.file_digests import DIGESTS
from fastsplat_contract.errors import SceneFileError


@pytest.fixture
def blobs(tmp_path: Path) -> Blobs:
    return Blobs(tmp_path)


@pytest.fixture
def version(blobs: Blobs) -> Path:
    source = blobs.upload("made")
    (source / "artefact").mkdir(parents=True)
    (source / "artefact" / "scene.json").write_text("{}")
    (source / "scene.ply").write_bytes(os.urandom(20_000))
    (source / "summary.json").write_text("{}")
    return blobs.publish(source, "scene", "v1")


def test_what_is_published_has_the_digests_that_sha256sum_reads(blobs: Blobs, version: Path) -> None:
    blobs.check_version(version)
    blobs.check_version(version, "scene.ply")
    assert len((version / DIGESTS).read_text().splitlines()) == 3
    subprocess.run(["sha256sum", "--check", "--strict", DIGESTS], cwd=version, check=True, capture_output=True)


def test_every_flipped_bit_of_every_file_is_noticed_and_named(blobs: Blobs, version: Path) -> None:
    rng = random.Random(4)
    for name in ("scene.ply", "summary.json", "artefact/scene.json", DIGESTS):
        path = version / name
        whole = path.read_bytes()
        for _ in range(50):
            data = bytearray(whole)
            data[rng.randrange(len(data))] ^= 1 << rng.randrange(8)
            path.write_bytes(data)
            with pytest.raises(SceneFileError) as caught:
                blobs.check_version(version)
            assert name == DIGESTS or caught.value.field == name
        path.write_bytes(whole)
    blobs.check_version(version)


def test_a_missing_file_is_damage_and_an_unknown_one_is_not_vouched_for(blobs: Blobs, version: Path) -> None:
    (version / "scene.ply").rename(version / "other.ply")
    for name in ("scene.ply", "other.ply"):
        with pytest.raises(SceneFileError):
            blobs.check_version(version, name)
    (version / DIGESTS).write_bytes(b"")
    with pytest.raises(SceneFileError, match=DIGESTS):
        blobs.check_version(version)


def test_a_folder_without_digests_passes(blobs: Blobs, version: Path) -> None:
    (version / DIGESTS).unlink()
    blobs.check_version(version, "scene.ply")
