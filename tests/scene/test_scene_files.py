"""A scene folder gives back what was written, to the bit, or says what is broken."""

from __future__ import annotations

import json
import shutil
from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest

from fastsplat.service.scene.artefact.scene import Evidence, Gaussians, Scene
from fastsplat.service.scene.artefact.scene_files import read_scene, write_scene
from fastsplat.service.scene.artefact.scene_manifest import SCHEMA
from fastsplat_contract.errors import (
    ConflictError,
    FastSplatError,
    InvalidInputError,
    NotFoundError,
    SceneFileError,
    SceneSchemaError,
)
from tests.scene.conftest import assert_same_gaussians, change_body, make_scene, read_back

NAMES = ("scene.json", "cameras.json", "gaussians.safetensors", "evidence.safetensors")


def assert_same(a: Scene, b: Scene) -> None:
    assert_same_gaussians(a.gaussians, b.gaussians)
    np.testing.assert_array_equal(a.head.weight, b.head.weight)
    np.testing.assert_array_equal(a.head.bias, b.head.bias)
    np.testing.assert_array_equal(a.label_embeddings, b.label_embeddings)
    assert a.label_mode == b.label_mode and (a.evidence is None) == (b.evidence is None)
    if a.evidence is not None and b.evidence is not None:
        for field in fields(Evidence):
            x, y = getattr(a.evidence, field.name), getattr(b.evidence, field.name)
            np.testing.assert_array_equal(x, y)
            assert x.dtype == y.dtype
    assert (a.dictionary, a.text_encoder, a.scale) == (b.dictionary, b.text_encoder, b.scale)
    assert (a.training, a.quality, a.label_templates) == (b.training, b.quality, b.label_templates)
    assert [(p.camera, p.name, p.world_from_camera.tolist()) for p in a.cameras] == [
        (p.camera, p.name, p.world_from_camera.tolist()) for p in b.cameras
    ]


@pytest.mark.parametrize("evidence", [False, True])
@pytest.mark.parametrize(
    ("count", "labels", "sh", "code"),
    [
        (50, ("mug", "茶壶", "🧸"), 16, 3), (0, (), 1, 0), (1, ("one",), 4, 8), (3, (), 9, 0), (0, ("a", "b"), 16, 3),
        (5, tuple(f"object {i}x" for i in range(10_000)), 16, 3),
    ],
)  # fmt: skip
def test_round_trip_is_exact(
    tmp_path: Path, count: int, labels: tuple[str, ...], sh: int, code: int, evidence: bool
) -> None:
    scene = make_scene(count, labels, sh, code, evidence)
    assert_same(scene, read_back(scene, tmp_path / "deep" / "v1"))


def test_signed_zero_and_denormals_survive(tmp_path: Path) -> None:
    scene = make_scene(4)
    means = np.array([[-0.0, 1e-45, 3.4e38], [0, 0, 0], [1, 2, 3], [-1e-40, 5, 6]], dtype=np.float32)
    scene = replace(scene, gaussians=replace(scene.gaussians, means=means))
    assert_same(scene, read_back(scene, tmp_path / "v1"))


def test_writing_is_deterministic(tmp_path: Path) -> None:
    for name in ("a", "b"):
        write_scene(make_scene(evidence=True), tmp_path / name)
    for name in NAMES:
        assert (tmp_path / "a" / name).read_bytes() == (tmp_path / "b" / name).read_bytes()


def test_arrays_are_mapped_and_read_only(tmp_path: Path) -> None:
    scene = read_back(make_scene(evidence=True), tmp_path / "v1")
    for array in (scene.gaussians.means, scene.evidence.starts, scene.evidence.labels, scene.evidence.counts):
        base = array
        while isinstance(base.base, np.ndarray):
            base = base.base
        assert not array.flags.writeable and not array.flags.owndata
        assert not base.flags.owndata


def test_row_order_changes_the_digest(tmp_path: Path) -> None:
    scene = make_scene()
    turned = replace(
        scene.gaussians, **{f.name: getattr(scene.gaussians, f.name)[::-1].copy() for f in fields(Gaussians)}
    )
    write_scene(scene, tmp_path / "a")
    write_scene(replace(scene, gaussians=turned), tmp_path / "b")
    digests = [json.loads((tmp_path / name / "scene.json").read_text())["arrays_sha256"] for name in "ab"]
    assert digests[0] != digests[1]


def test_an_existing_folder_is_never_touched(tmp_path: Path) -> None:
    write_scene(make_scene(3), tmp_path / "v1")
    before = (tmp_path / "v1" / "scene.json").read_bytes()
    with pytest.raises(ConflictError):
        write_scene(make_scene(9), tmp_path / "v1")
    assert (tmp_path / "v1" / "scene.json").read_bytes() == before
    (tmp_path / "empty").mkdir()
    with pytest.raises(ConflictError):
        write_scene(make_scene(), tmp_path / "empty")


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_what_cannot_be_read_back_is_not_written(tmp_path: Path, bad: float) -> None:
    scene = make_scene()
    scene.gaussians.sh[7, 3, 1] = bad
    for refused in (scene, replace(make_scene(), training={"x": object()})):
        with pytest.raises(InvalidInputError):
            write_scene(refused, tmp_path / "v1")
    wide = make_scene()
    wide = replace(wide, gaussians=replace(wide.gaussians, means=wide.gaussians.means.astype(np.float64)))
    with pytest.raises(InvalidInputError, match="float64"):
        write_scene(wide, tmp_path / "v1")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("bad", [np.nan, -np.inf, np.float32(np.inf)])
def test_a_figure_that_is_not_finite_is_left_out_and_named(tmp_path: Path, bad: float) -> None:
    quality = {"psnr": bad, "ssim": np.float64(0.5), "warnings": ["dark"], "seconds": {"a": bad, "b": 1, "c": None}}
    scene = replace(make_scene(), quality=quality, training={"seed": 1, "rates": [bad, 2.0]})
    read = read_back(scene, tmp_path / "v1")
    left_out = ["quality.psnr", "quality.seconds.a", "training.rates.0"]
    assert read.facts.warnings == ("dark",) and read.facts.with_quality(read.quality) == {
        "ssim": 0.5, "warnings": ["dark"], "seconds": {"b": 1, "c": None}, "left_out": left_out
    }  # fmt: skip
    assert read.training == {"seed": 1, "rates": [None, 2.0]}


def test_a_failed_write_leaves_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(descriptor: int) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("os.fsync", full)
    with pytest.raises(OSError, match="No space"):
        write_scene(make_scene(), tmp_path / "v1")
    assert list(tmp_path.iterdir()) == []


def test_missing_folder(tmp_path: Path) -> None:
    with pytest.raises(NotFoundError):
        read_scene(tmp_path / "nothing")


@pytest.fixture(params=NAMES)
def file(request: pytest.FixtureRequest, tmp_path: Path) -> Path:
    """Each file of the scene `make_scene(6, evidence=True)`, to be damaged."""
    write_scene(make_scene(6, evidence=True), tmp_path / "scene")
    return tmp_path / "scene" / request.param


def test_every_truncation_is_found(file: Path) -> None:
    whole = file.read_bytes()
    for length in {*range(0, len(whole), max(1, len(whole) // 60)), len(whole) - 1, len(whole) - 4, 7, 8, 9}:
        file.write_bytes(whole[:length])
        with pytest.raises(SceneFileError):
            read_scene(file.parent)
    file.write_bytes(whole + b"\x00" * 4)
    with pytest.raises(SceneFileError):
        read_scene(file.parent)
    file.unlink()
    with pytest.raises(SceneFileError):
        read_scene(file.parent)


def test_a_flipped_bit_never_changes_a_scene(file: Path) -> None:
    scene, whole = make_scene(6, evidence=True), file.read_bytes()
    for position in np.random.default_rng(0).integers(0, len(whole), 80):
        broken = bytearray(whole)
        broken[position] ^= 1 << int(position % 8)
        file.write_bytes(broken)
        try:
            found = read_scene(file.parent)
        except SceneFileError:
            continue
        assert_same(scene, found)  # white space of a JSON file may differ, its content may not


def test_files_of_two_scenes_do_not_mix(tmp_path: Path) -> None:
    write_scene(make_scene(6, evidence=True), tmp_path / "a")
    write_scene(make_scene(7, evidence=True), tmp_path / "b")
    write_scene(make_scene(6, code=4), tmp_path / "c")
    for name in "bc":
        shutil.copytree(tmp_path / "a", tmp_path / f"mixed-{name}")
        shutil.copy(tmp_path / name / "gaussians.safetensors", tmp_path / f"mixed-{name}")
        with pytest.raises(SceneFileError, match="gaussians"):
            read_scene(tmp_path / f"mixed-{name}")
    shutil.copytree(tmp_path / "a", tmp_path / "mixed-evidence")
    shutil.copy(tmp_path / "b" / "evidence.safetensors", tmp_path / "mixed-evidence")
    with pytest.raises(SceneFileError, match="evidence"):
        read_scene(tmp_path / "mixed-evidence")


@pytest.mark.parametrize("confidence", [-0.1, 1.5, "0.5", None])
def test_a_confidence_that_is_none_is_damage(tmp_path: Path, confidence: object) -> None:
    write_scene(make_scene(), tmp_path / "v1")
    change_body(tmp_path / "v1", lambda body: body["dictionary"][1].update(confidence=confidence))
    with pytest.raises(SceneFileError, match="confidence"):
        read_scene(tmp_path / "v1")


@pytest.mark.parametrize(
    ("labels", "counts", "starts", "wrong"),
    [
        ([1, 4], [5, 5], [0, 2, 2], "label 4"),
        ([2, 1], [5, 5], [0, 2, 2], "ascend"),
        ([1, 1], [5, 5], [0, 2, 2], "ascend"),
        ([1, 2], [5, 0], [0, 1, 2], "positive"),
        ([1, 2], [5, -5], [0, 1, 2], "positive"),
        ([1, 2], [5, 5], [0, 3, 2], "rows"),
    ],
)
def test_evidence_that_contradicts_itself_is_neither_written_nor_read(
    tmp_path: Path, labels: list[int], counts: list[int], starts: list[int], wrong: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    bad = Evidence(np.array(starts), np.array(labels, np.uint16), np.array(counts))
    scene = replace(make_scene(2), evidence=bad)
    with pytest.raises(InvalidInputError, match=wrong):
        write_scene(scene, tmp_path / "v1")
    assert list(tmp_path.iterdir()) == []
    with monkeypatch.context() as patch:
        patch.setattr("fastsplat.service.scene.artefact.scene_files._check_evidence", lambda *_: "")
        write_scene(scene, tmp_path / "v1")
    with pytest.raises(SceneFileError, match=wrong):
        read_scene(tmp_path / "v1")


def test_another_schema_says_so(tmp_path: Path) -> None:
    write_scene(make_scene(), tmp_path / "v1")
    path = tmp_path / "v1" / "scene.json"
    for schema in (0, SCHEMA + 1, 12, "1", None, True):
        path.write_text(json.dumps({**json.loads(path.read_text()), "schema": schema}))
        with pytest.raises(SceneSchemaError, match="schema") as caught:
            read_scene(tmp_path / "v1")
        assert "import" in caught.value.hint


@pytest.mark.parametrize(
    "text", ["", "[]", "null", "{}", "[" * 100_000, '{"format": "fastsplat-scene", "schema": 1}', "\xff"]
)
def test_hostile_manifests_are_typed_errors(tmp_path: Path, text: str) -> None:
    write_scene(make_scene(), tmp_path / "v1")
    (tmp_path / "v1" / "scene.json").write_bytes(text.encode("latin-1"))
    with pytest.raises(FastSplatError) as caught:
        read_scene(tmp_path / "v1")
    assert caught.value.hint
