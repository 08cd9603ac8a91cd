"""`make look` shows what `make demo` trained, or the sample scene where that has not run."""

from __future__ import annotations

import re
import shlex
from pathlib import Path

import pytest

from demo.__main__ import how_to_look
from demo.look import SAMPLE, TRAINED, folder_to_look_at, missing_text_encoder
from fastsplat.service.library.local_scene import open_scene
from fastsplat.service.settings import load_settings
from fastsplat.service.store.database import SQLITE_NAME

_MAKEFILE = (Path(__file__).parents[2] / "Makefile").read_text()


def test_make_look_serves_what_make_demo_trains(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    TRAINED.mkdir(parents=True)
    (TRAINED / SQLITE_NAME).touch()
    assert folder_to_look_at() == TRAINED and how_to_look(TRAINED.parent) == "make look"
    (recipe,) = re.findall(r"^look:.*\n((?:\t.*\n)+)", _MAKEFILE, re.MULTILINE)
    assert "python -m demo.look" in recipe


def test_the_sample_scene_is_there_without_training_and_keeps_what_is_done_to_it(
    models_dir: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    assert folder_to_look_at() == SAMPLE
    with open_scene(SAMPLE) as scene:
        thing = next(thing for thing in scene.things() if thing.name == "cup")
        scene.name(thing.id, "beaker of tea")
    assert folder_to_look_at() == SAMPLE
    with open_scene(SAMPLE) as scene:
        assert "beaker of tea" in {thing.name for thing in scene.things()}
    assert [path.name for path in tmp_path.iterdir()] == [SAMPLE.name]  # nothing unfinished is left


def test_the_text_encoder_is_fetched_only_where_it_is_missing(
    tmp_path: Path, models_dir: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for folder, missing in ((tmp_path, "minilm_l6_int8"), (models_dir, "")):
        monkeypatch.setenv("FASTSPLAT_MODELS", str(folder))
        load_settings.cache_clear()
        assert missing_text_encoder() == missing


def test_another_output_is_served_by_name() -> None:
    folder, program, *rest = shlex.split(how_to_look(Path("else where")))
    assert folder == "FASTSPLAT_DATA_DIR=else where/service" and rest == ["serve", "--no-auth"]
    assert Path(program).is_file()
