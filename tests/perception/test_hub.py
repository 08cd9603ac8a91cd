"""Files of a hub: the newest commit, resolved before anything is fetched, then kept to; all else is refused whole."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from fastsplat.service.perception.model_pull.pull import model_state, pull
from fastsplat.service.perception.models.model_manifest import load_manifest
from fastsplat_contract.errors import ModelUnavailableError
from tests.hub import FIRST, SECOND, Hub, planted_hub, serving_hub

_Planned = tuple[str, int, tuple[str, ...]]
"""Name, size and commits of a model."""


@pytest.fixture
def served(tmp_path: Path) -> Iterator[tuple[Hub, Path]]:
    hub, manifest = planted_hub(tmp_path / "made")
    with serving_hub(hub):
        yield hub, manifest


def _pull(models: Path, manifest: Path, *names: str, revision: str | None = None) -> list[_Planned]:
    """Pulls the set; returns what was planned."""
    planned: list[_Planned] = []
    pull(
        models,
        names or ("open-vocabulary",),
        report=lambda step: None,
        planned=lambda entry: planned.append((entry.name, entry.size, entry.commits)),
        manifest=manifest,
        revision=revision,
    )
    return planned


def _receipt(models: Path, name: str) -> dict[str, dict[str, object]]:
    receipt: dict[str, dict[str, object]] = json.loads((models / name / "pulled.json").read_text())
    return receipt


def test_the_newest_commit_is_planned_first_then_kept_to(served: tuple[Hub, Path], tmp_path: Path) -> None:
    hub, manifest = served
    models, files = tmp_path / "models", hub.commits[FIRST]
    planned = _pull(models, manifest)
    sizes = {name: sum(len(files[path]) for path in files if path.startswith(name)) for name in ("looks", "finder")}
    assert planned == [(name, size, (f"made/models at {FIRST}",)) for name, size in sizes.items()]
    noted = _receipt(models, "finder")["hub"]["model.onnx"]
    assert noted == {"repo": "made/models", "path": "finder/model.onnx", "commit": FIRST}
    assert all(model_state(entry, models) == "ready" for entry in load_manifest(manifest))
    hub.commits[SECOND], hub.main = {**files, "looks/text.onnx": files["looks/text.onnx"] + b" "}, SECOND
    hub.fetched.clear()
    assert _pull(models, manifest) == [] == hub.fetched
    (models / "looks" / "text.onnx").write_bytes(b"damaged")
    assert _pull(models, manifest)[0][2] == (f"made/models at {FIRST}",)
    assert (models / "looks" / "text.onnx").read_bytes() == files["looks/text.onnx"]


def test_a_named_commit_replaces_the_one_that_is_there(served: tuple[Hub, Path], tmp_path: Path) -> None:
    hub, manifest = served
    files = hub.commits[FIRST]
    hub.commits[SECOND] = {**files, "looks/tokenizer.json": files["looks/tokenizer.json"] + b" "}
    _pull(tmp_path / "models", manifest)
    _pull(tmp_path / "models", manifest, "looks", revision=SECOND)
    assert (tmp_path / "models/looks/tokenizer.json").read_bytes().endswith(b" ")
    assert _receipt(tmp_path / "models", "looks")["hub"]["text.onnx"]["commit"] == SECOND


def _sends(path: str, ending: bytes) -> Callable[[Hub], object]:
    return lambda hub: hub.sends.update({path: hub.commits[FIRST][path][:-1] + ending})


_TEXT, _WORDS = "looks/text.onnx", "looks/tokenizer.json"
_FAULTS: dict[str, tuple[str, Callable[[Hub], object]]] = {
    "another network": ("sha256 is", _sends(_TEXT, b"!")),
    "another small file": ("git blob is", _sends(_WORDS, b" ")),
    "another size": ("bytes, expected", _sends(_TEXT, b"larger")),
    "half a file": ("incomplete|closed|bytes", lambda hub: setattr(hub, "cut", _TEXT)),
    "no file": (r"text\.onnx: 404 Not Found$", lambda hub: hub.sends.update({_TEXT: None})),
    "no such path": (f"has no {_TEXT}", lambda hub: hub.commits[FIRST].pop(_TEXT)),
    "no commit": ("main: 404 Not Found$", lambda hub: hub.commits.clear()),
    "a name for a commit": ("sha", lambda hub: hub.says.update(sha="main")),
    "no digests": ("says no digest", lambda hub: hub.says.update(lfs=None, blobId=None)),
    "a wrong size": ("size", lambda hub: hub.says.update(size="large")),
}


@pytest.mark.parametrize("fault", _FAULTS)
def test_what_a_hub_does_not_give_as_it_said_is_refused_and_can_be_pulled_later(
    served: tuple[Hub, Path], tmp_path: Path, fault: str
) -> None:
    (hub, manifest), models = served, tmp_path / "models"
    good = dict(hub.commits[FIRST])
    said, spoil = _FAULTS[fault]
    spoil(hub)
    with pytest.raises(ModelUnavailableError, match=said) as caught:
        _pull(models, manifest)
    assert caught.value.hint and list(models.iterdir()) == []
    hub.commits, hub.says, hub.sends, hub.cut = {FIRST: good}, {}, {}, "-"
    _pull(models, manifest)
    assert sorted(path.name for path in models.iterdir()) == ["finder", "looks"]


def test_a_commit_whose_files_have_changed_is_no_longer_trusted(served: tuple[Hub, Path], tmp_path: Path) -> None:
    (hub, manifest), models = served, tmp_path / "models"
    _pull(models, manifest)
    (models / "looks" / "text.onnx").write_bytes(b"damaged")
    hub.commits[FIRST]["looks/text.onnx"] += b" "
    for said, facts in (("has the sha256", {}), (f"has {SECOND} for the commit {FIRST}", {"sha": SECOND})):
        hub.says = facts
        with pytest.raises(ModelUnavailableError, match=said):
            _pull(models, manifest)


def test_without_a_network_it_is_said(served: tuple[Hub, Path], tmp_path: Path) -> None:
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("HF_ENDPOINT", "http://127.0.0.1:9")
        with pytest.raises(ModelUnavailableError, match="could not be looked up"):
            _pull(tmp_path / "models", served[1])
