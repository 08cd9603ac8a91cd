"""Models arrive whole, verified and tried, or not at all. Carriers are made here; nothing goes over the network."""

from __future__ import annotations

import hashlib
import http.server
import io
import tarfile
import zipfile
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

from fastsplat.cli.operating.models import models_app
from fastsplat.service.perception.model_pull import sources
from fastsplat.service.perception.model_pull.pull import Step, model_state, pull
from fastsplat.service.perception.model_pull.sources import fetch_file
from fastsplat.service.perception.models.model_manifest import (
    PERMISSIVE,
    ROLES,
    ModelFile,
    PackageSource,
    find_model,
    load_manifest,
)
from fastsplat.service.perception.text.text_encoders import open_text_encoder
from fastsplat_contract.errors import InvalidInputError, ModelUnavailableError, ResourceError
from tests.client.scripted import serving

_HEAD = '[[model]]\nname = "words"\nrole = "text_encoder"\nadapter = "label_table"\nabout = "A few words."'


def _sha256(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()


def _manifest(table: Path, sha256: str = "", spdx: str = "MIT") -> Path:
    """A manifest beside a label table, which it calls "words" and copies; `sha256`: where it expects another."""
    path = table.with_name("manifest.toml")
    path.write_text(
        f"""
        {_HEAD}
        license = "{spdx}"
        default = true
        [[model.files]]
        name = "table.npz"
        size = {table.stat().st_size}
        sha256 = "{sha256 or _sha256(table.read_bytes())}"
        [[model.files.sources]]
        kind = "local"
        path = "{table}"
        """
    )
    return path


def _pull(models: Path, manifest: Path, **options: Any) -> list[str]:
    """Pulls the default models; returns what each step was."""
    steps = list[Step]()
    pull(models, report=steps.append, manifest=manifest, **options)
    return [step.what for step in steps]


@pytest.fixture
def models(tmp_path: Path) -> Path:
    """Where models are pulled to: not there yet."""
    return tmp_path / "models"


@pytest.fixture
def half(models: Path) -> Path:
    """A file of the model that is not whole."""
    (models / "words").mkdir(parents=True)
    (models / "words" / "table.npz").write_bytes(b"half a tab")
    return models / "words" / "table.npz"


def test_a_local_source_is_copied_tried_and_kept(table: Path, models: Path) -> None:
    manifest = _manifest(table)
    assert _pull(models, manifest)[-1] == "ready"
    (entry,) = load_manifest(manifest)
    assert model_state(entry, models) == "ready"
    assert open_text_encoder("label_table:words", models).sha256 == _sha256(table.read_bytes())
    assert [path.name for path in models.iterdir()] == ["words"]
    assert _pull(models, manifest) == ["already there"]


def test_a_wrong_checksum_leaves_nothing_behind(table: Path, models: Path) -> None:
    with pytest.raises(ModelUnavailableError, match="sha256"):
        _pull(models, _manifest(table, "0" * 64))
    assert list(models.iterdir()) == []


@pytest.mark.parametrize(("names", "said"), [((), "label table"), (("cup", "mug", "bridge"), "does not work")])
def test_a_model_that_fails_its_trial_leaves_nothing_behind(
    tmp_path: Path, models: Path, names: tuple[str, ...], said: str
) -> None:
    """It is no table, or opens, keeps its contract, and knows nothing."""
    path = tmp_path / "table.npz"
    path.write_bytes(b"not a table")
    if names:
        np.savez(path, names=np.array(names), embeds=np.ones((3, 2), np.float32))
    with pytest.raises(ModelUnavailableError, match=said):
        _pull(models, _manifest(path))
    assert list(models.iterdir()) == []


def test_a_damaged_model_is_replaced(table: Path, models: Path, half: Path) -> None:
    manifest = _manifest(table)
    (entry,) = load_manifest(manifest)
    assert model_state(entry, models) == "damaged"
    _pull(models, manifest)
    assert half.read_bytes() == table.read_bytes()
    assert [path.name for path in models.iterdir()] == ["words"]


def test_licenses_need_a_yes(table: Path, models: Path) -> None:
    manifest = _manifest(table, spdx="AGPL-3.0-only")
    with pytest.raises(InvalidInputError) as caught:
        _pull(models, manifest)
    assert "AGPL-3.0-only" in caught.value.message and "--allow-license" in caught.value.hint
    assert not models.exists()
    _pull(models, manifest, allow_licenses=["AGPL-3.0-only"])
    assert (models / "words" / "table.npz").is_file()


def _wheel(path: Path, member: str, inner: bytes) -> bytes:
    with zipfile.ZipFile(path, "w") as wheel:
        wheel.writestr(member, inner)
    return path.read_bytes()


def _tar(path: Path, member: str, inner: bytes) -> bytes:
    with tarfile.open(path, "w:gz") as bundle:
        info = tarfile.TarInfo(member)
        info.size = len(inner)
        bundle.addfile(info, io.BytesIO(inner))
    return path.read_bytes()


@pytest.mark.parametrize("kind", ["wheel", "source archive"])
@pytest.mark.parametrize("fault", ["", "archive", "member", "path"])
def test_package_carriers_are_verified_twice(
    kind: str, fault: str, table: Path, models: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The archive by its hash, then the file inside by its own. Only the download itself is replaced."""
    inner = table.read_bytes()
    build, name = (_wheel, "c-1-py3-none-any.whl") if kind == "wheel" else (_tar, "c-1.tar.gz")
    archive = build(tmp_path / name, "carrier/table.npz", inner)
    monkeypatch.setattr(sources, "_pip_download", lambda source, folder: (folder / name).write_bytes(archive))
    manifest = tmp_path / "manifest.toml"
    manifest.write_text(
        f"""
        {_HEAD}
        license = "MIT"
        [[model.files]]
        name = "table.npz"
        sha256 = "{"1" * 64 if fault == "member" else _sha256(inner)}"
        [[model.files.sources]]
        kind = "local"
        path = "missing.npz"
        [[model.files.sources]]
        kind = "pypi"
        package = "carrier"
        version = "1"
        path = "carrier/{"other" if fault == "path" else "table"}.npz"
        sha256 = "{"2" * 64 if fault == "archive" else _sha256(archive)}"
        """
    )
    if not fault:
        _pull(models, manifest, names=["words"])
        assert (models / "words" / "table.npz").read_bytes() == inner
        return
    with pytest.raises(ModelUnavailableError) as caught:
        _pull(models, manifest, names=["words"])
    assert "no such file" in caught.value.message and "pypi carrier 1" in caught.value.message
    assert list(models.iterdir()) == []


def test_the_built_in_manifest_is_sound(models_dir: Path) -> None:
    entries = load_manifest()
    defaults = {"minilm_l6_int8", "picodet_416", "mobile_sam", "wordnet", "ppocr_v6_small"}
    assert {entry.name for entry in entries if entry.default} == defaults
    for entry in entries:
        assert entry.license in PERMISSIVE
        assert find_model(entry.name, entry.role)[0] in ROLES[entry.role]
        for file in (*entry.files, *(entry.conversion.carriers if entry.conversion else ())):
            packaged = [source for source in file.sources if source.kind in ("pypi", "npm")]
            assert not packaged or (file.sha256 and file.size)
    minilm = next(entry for entry in entries if entry.name == "minilm_l6_int8")
    assert model_state(minilm, models_dir) == "ready"


def test_command_line(table: Path, models: Path) -> None:
    options = ["--models", str(models), "--manifest", str(_manifest(table))]
    invoke = CliRunner().invoke  # without a terminal
    assert "absent" in invoke(models_app, ["list", *options]).output
    assert (pull := invoke(models_app, ["pull", "words", *options])).exit_code == 0 and "trying it out\n" in pull.output
    assert "ready" in invoke(models_app, ["list", *options]).output
    assert "nonsense" in str(invoke(models_app, ["pull", "nonsense", *options]).exception)


def test_what_was_put_there_by_hand_is_kept_if_it_works(table: Path, models: Path) -> None:
    """A file under another name than the manifest's: nothing is fetched, nothing is touched; unless it is broken."""
    manifest, folder = _manifest(table), models / "words"
    folder.mkdir(parents=True)
    (folder / "own.npz").write_bytes(table.read_bytes())
    (entry,) = load_manifest(manifest)
    assert model_state(entry, models) == "unverified"
    _pull(models, manifest)
    assert [path.name for path in folder.iterdir()] == ["own.npz"]
    (folder / "own.npz").write_bytes(b"broken")
    _pull(models, manifest)
    assert sorted(path.name for path in folder.iterdir()) == ["pulled.json", "table.npz"]


@pytest.mark.parametrize("marked", ["directory", "model"])
def test_what_is_marked_read_only_is_left_alone_by_root_too(table: Path, models: Path, half: Path, marked: str) -> None:
    manifest, steps = _manifest(table), list[Step]()
    folder = models if marked == "directory" else models / "words"
    folder.chmod(0o555)
    try:
        with pytest.raises(ResourceError, match="read-only") as caught:
            pull(models, report=steps.append, manifest=manifest)
    finally:
        folder.chmod(0o755)
    assert caught.value.field == "models" and str(folder) in caught.value.message and "--models" in caught.value.hint
    assert steps == [] and half.read_bytes() == b"half a tab"
    assert [path.name for path in models.iterdir()] == ["words"]
    _pull(models, manifest)
    models.chmod(0o555)  # nothing has to be written for models that are there
    try:
        assert _pull(models, manifest)[-1] == "already there"
    finally:
        models.chmod(0o755)


@pytest.mark.parametrize("fault", ["", "absent", "archive"])
def test_a_package_of_npm_comes_without_npm(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, fault: str) -> None:
    """A server that was installed as a wheel needs no Node.js."""
    registry, inner = tmp_path / "registry", b"entry one\n"
    archive = registry / "@words" / "nouns" / "-" / "nouns-1.2.3.tgz"
    archive.parent.mkdir(parents=True)
    content = _tar(archive, "package/dict/index", inner)
    digest = _sha256(content if fault != "archive" else b"another")
    if fault == "absent":
        archive.unlink()
    source = PackageSource(
        kind="npm", package="@words/nouns", version="1.2.3", path="package/dict/index", sha256=digest
    )
    file = ModelFile(name="index", sources=(source,), size=len(inner), sha256=_sha256(inner))
    target = tmp_path / "index"
    fetch = partial(fetch_file, file, target, cache=tmp_path, base=tmp_path, on_bytes=lambda done, total: None)
    handler = partial(http.server.SimpleHTTPRequestHandler, directory=str(registry))
    with serving(http.server.ThreadingHTTPServer(("127.0.0.1", 0), handler)) as server:
        monkeypatch.setenv("npm_config_registry", f"http://127.0.0.1:{server.server_port}/")
        monkeypatch.setenv("PATH", "")
        if not fault:
            fetch()
            assert target.read_bytes() == inner
            return
        with pytest.raises(ModelUnavailableError, match="404" if fault == "absent" else "sha256"):
            fetch()
        assert not target.exists()
