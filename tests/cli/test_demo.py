"""`fastsplat demo`: what it shows, names, may empty and fetches; the two commands of the README call it."""

from __future__ import annotations

import os
import re
import shlex
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from fastsplat.cli.demo import command
from fastsplat.cli.demo.command import clear, demo, prepare, pull_defaults, pull_text_encoder
from fastsplat.cli.demo.main_job import SAMPLE_PHOTOS, object_to_name
from fastsplat.cli.operating.browser import has_desktop
from fastsplat.cli.scenes.ask_command import answer_lines
from fastsplat.service.library.local_scene import open_scene
from fastsplat.service.library.sample import open_sample
from fastsplat.service.settings import load_settings
from fastsplat.service.store.rows.database import SQLITE_NAME
from fastsplat_contract.errors import ConflictError, InvalidInputError, ResourceError
from fastsplat_contract.messages.objects import SceneObject
from release.check_wheels import free_ports

_ROOT = Path(__file__).parents[2]


@pytest.mark.parametrize(("target", "command"), [("look", "fastsplat demo"), ("demo", "fastsplat demo --train")])
def test_the_two_commands_of_the_readme_build_the_page_and_call_it(target: str, command: str) -> None:
    rule = rf"^{target}:(.*)  ##.*\n((?:\t.*\n)+)"
    ((needed, recipe),) = re.findall(rule, (_ROOT / "Makefile").read_text(), re.MULTILINE)
    assert recipe.strip().removeprefix("$(BIN)/").partition(" $(if")[0] == command
    assert {"$(PAGE)", "$(VENV)/.product"} <= set(needed.split())


def test_the_package_has_the_photos_of_the_sample() -> None:
    photos = sorted(_ROOT.glob("demo/sample/images/*.jpg"))
    assert photos and [path.name for path in photos] == sorted(path.name for path in SAMPLE_PHOTOS.iterdir())


def test_the_sample_scene_is_there_without_training_and_keeps_what_is_done_to_it(
    models_dir: Path, tmp_path: Path
) -> None:
    folder = tmp_path / "demo"
    prepare(folder)
    with open_scene(folder / "service") as scene:
        obj = next(obj for obj in scene.objects() if obj.name == "cup")
        scene.name(obj.id, "beaker of tea")
    prepare(folder)
    with open_scene(folder / "service") as scene:
        assert "beaker of tea" in {obj.name for obj in scene.objects()}
    assert sorted(path.name for path in folder.iterdir()) == [".fastsplat-demo", "service"]  # nothing unfinished


def test_what_was_trained_is_shown(tmp_path: Path) -> None:
    (tmp_path / "service").mkdir()
    (tmp_path / "service" / SQLITE_NAME).touch()
    prepare(tmp_path)
    assert (tmp_path / "service" / SQLITE_NAME).stat().st_size == 0


def test_only_what_a_demonstration_made_is_emptied(tmp_path: Path) -> None:
    folder = tmp_path / "home"
    folder.mkdir()
    clear(folder)
    (folder / "report.json").touch()
    clear(folder)
    assert [path.name for path in folder.iterdir()] == [".fastsplat-demo"]
    (tmp_path / "photos").mkdir()
    (tmp_path / "photos" / "mine.jpg").touch()
    (tmp_path / "file").touch()
    for name in ("photos", "file"):
        with pytest.raises(ConflictError, match="no demonstration made") as caught:
            clear(tmp_path / name)
        assert caught.value.field == "folder"
    assert (tmp_path / "photos" / "mine.jpg").is_file() and (tmp_path / "file").is_file()


def test_the_text_encoder_is_fetched_only_where_it_is_missing(
    tmp_path: Path, models_dir: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("FASTSPLAT_MODELS", str(models_dir))
    load_settings.cache_clear()
    pull_text_encoder()
    (tmp_path / "file").touch()
    monkeypatch.setenv("FASTSPLAT_MODELS", str(tmp_path / "file"))  # no folder, so a fetch ends before it begins
    load_settings.cache_clear()
    with pytest.raises(ResourceError, match="cannot be made"):
        pull_text_encoder()
    load_settings.cache_clear()


def test_objects_that_may_be_what_is_asked_for_are_listed(
    lexicon_models_dir: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("FASTSPLAT_MODELS", str(lexicon_models_dir))
    load_settings.cache_clear()
    with open_sample() as scene:
        answer = scene.ask("fork")
    load_settings.cache_clear()
    listed = f"  objects that may be it: {', '.join(map(str, answer.object_ids))}"
    assert len(answer.object_ids) > 1 and answer_lines(answer)[1] == listed


def test_models_that_others_share_are_left_as_they_are(
    tmp_path: Path, models_dir: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    shared = tmp_path / "shared"
    (shared / "minilm_l6_int8").mkdir(parents=True)
    (shared / "minilm_l6_int8" / "model.onnx").write_bytes(b"network")
    shared.chmod(0o555)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("FASTSPLAT_MODELS", str(shared))
    pulled: list[Path] = []
    monkeypatch.setattr(command, "pull_with_progress", pulled.append)
    load_settings.cache_clear()
    try:
        pull_defaults()
        assert pulled == [tmp_path / ".models"] == [load_settings().models]
        assert (tmp_path / ".models" / "minilm_l6_int8" / "model.onnx").read_bytes() == b"network"
    finally:
        shared.chmod(0o755)
        load_settings.cache_clear()


def test_what_belongs_to_a_training_is_refused_without(tmp_path: Path) -> None:
    folder = tmp_path / "demo"
    with pytest.raises(InvalidInputError, match="--train"):
        demo(train=False, photos=None, ask=["cup"], seconds=None, folder=folder)
    with pytest.raises(InvalidInputError, match="does not exist"):
        demo(train=True, photos=tmp_path / "none", ask=None, seconds=None, folder=folder)
    assert not folder.exists()


def test_a_browser_is_opened_only_where_there_is_a_screen(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "platform", "linux")
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    assert not has_desktop()
    monkeypatch.setenv("WAYLAND_DISPLAY", "wayland-0")
    assert has_desktop()


def test_the_browser_opens_when_the_sample_can_be_seen(models_dir: Path, tmp_path: Path) -> None:
    ports = [str(port) for port in free_ports(2)]
    browser, seen = tmp_path / "browser", tmp_path / "seen"
    browser.write_text(f'#!/bin/sh\necho "$1" > {shlex.quote(str(seen))}\n')
    browser.chmod(0o755)
    environment = {
        **os.environ,
        "FASTSPLAT_MODELS": str(models_dir),
        "FASTSPLAT_HTTP_PORT": ports[0],
        "FASTSPLAT_GRPC_PORT": ports[1],
        "FASTSPLAT_METRICS_PORT": "0",
        "DISPLAY": ":0",
        "BROWSER": f"{browser} %s",
    }
    process = subprocess.Popen(
        [sys.executable, "-m", "fastsplat.cli.main", "demo"],
        cwd=tmp_path,
        env=environment,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        text=True,
    )
    try:
        assert process.stdout is not None and "without a key" in process.stdout.readline()
        while process.poll() is None and not (seen.is_file() and seen.read_text()):
            time.sleep(0.1)
        assert process.poll() is None
        assert seen.read_text().strip() == f"http://localhost:{ports[0]}"
    finally:
        process.send_signal(signal.SIGTERM)
        process.wait()
    assert (tmp_path / "demo-output" / "service" / SQLITE_NAME).is_file()


def _object(object_id: int, name: str = "", kind: str = "object") -> SceneObject:
    source = "detected" if name else None
    return SceneObject(object_id, name, source, 0.0, (), kind, "", 1.0, 10, None, False)


def test_the_largest_object_without_a_name_is_named_and_a_whole_one_first() -> None:
    ids = np.pad(np.repeat(np.array([1, 2, 3, 4], np.uint16), [40, 30, 20, 10]).reshape(10, 10), 1)
    objects = {1: _object(1, kind="surface"), 2: _object(2, "cup"), 3: _object(3), 4: _object(4)}
    assert object_to_name(ids, objects) == 3
    ids[0, 0] = 3
    assert object_to_name(ids, objects) == 4
    assert object_to_name(ids, {**objects, 3: _object(3, "bowl"), 4: _object(4, "fork")}) is None
