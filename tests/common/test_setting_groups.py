"""Settings: variables are named by the fields that they set; one that sets nothing is refused, wherever it stands."""

from __future__ import annotations

import json
import re
import subprocess
from collections.abc import Iterator
from difflib import SequenceMatcher
from pathlib import Path

import pytest
from pydantic import BaseModel, Field

from docs.settings_page import PAGE, settings_page
from fastsplat.service.common.setting_groups import (
    ENV_PREFIX,
    OTHER_VARIABLES,
    SettingGroup,
    environment_variable,
    group_of,
    settings_of,
)
from fastsplat.service.settings import JobSettings, Settings, load_settings
from fastsplat.service.splatting.training_settings import LearningRates
from fastsplat_contract.errors import InvalidInputError

ROOT = Path(__file__).parent.parent.parent
_GROUPS = {name: group for name, field in settings_of(Settings).items() if (group := group_of(field)) is not None}
_SINGLE = [name for name in settings_of(Settings) if name not in _GROUPS]
_CONSTANTS = [
    f"{name}__{constant}"
    for name, group in _GROUPS.items()
    for constant in sorted(group.model_fields.keys() - settings_of(group))
]


def _names() -> Iterator[str]:
    yield from settings_of(Settings)
    for name, group in _GROUPS.items():
        yield from (f"{name}__{inner}" for inner in settings_of(group))


@pytest.fixture(autouse=True)
def _fresh() -> Iterator[None]:
    load_settings.cache_clear()
    yield
    load_settings.cache_clear()


def test_a_group_knows_under_which_name_it_is_set() -> None:
    assert {name: group.section for name, group in _GROUPS.items()} == {name: name for name in _GROUPS}
    assert len(_GROUPS) > 10


@pytest.mark.parametrize("field", settings_of(JobSettings))
def test_the_variable_that_is_derived_from_a_field_sets_it(field: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(environment_variable(JobSettings, field), value := "ray" if field == "launcher" else "7")
    assert str(getattr(load_settings().jobs, field)).removesuffix(".0") == value


def test_variables_are_derived_from_fields_that_exist() -> None:
    assert environment_variable(Settings, "http_port") == "FASTSPLAT_HTTP_PORT"
    for name in ("max_start", "progress_interval_s"):
        with pytest.raises(AttributeError, match=name):
            environment_variable(JobSettings, name)


@pytest.mark.parametrize("group", [Settings, LearningRates, *_GROUPS.values()])
def test_every_setting_and_constant_is_documented_under_it(group: type[BaseModel]) -> None:
    fields = group.model_fields if group is not Settings else {name: Settings.model_fields[name] for name in _SINGLE}
    assert not [name for name, field in fields.items() if not field.description]


def test_settings_stay_few_enough_to_be_read() -> None:
    """A new one needs an operator who must change it, and another that nobody does."""
    assert len(_SINGLE) + sum(len(settings_of(group)) for group in _GROUPS.values()) <= 100


def test_the_page_of_all_settings_is_up_to_date() -> None:
    assert PAGE.read_text() == settings_page(), "run python -m docs.settings_page"


def test_no_variable_sets_a_constant(monkeypatch: pytest.MonkeyPatch) -> None:
    assert "training__ssim_weight" in _CONSTANTS
    for constant in (*_CONSTANTS, "training__rates__means", "store", "store__max_labels", "prompts__views"):
        variable = f"{ENV_PREFIX}{constant.upper()}"
        with monkeypatch.context() as patched:
            patched.setenv(variable, "1")
            with pytest.raises(InvalidInputError, match="is no setting"):
                load_settings()
        if constant in _CONSTANTS:
            group, name = constant.split("__")
            with monkeypatch.context() as patched:
                patched.setenv(f"{ENV_PREFIX}{group.upper()}", json.dumps({name: 1}))
                with pytest.raises(InvalidInputError, match="is no setting") as caught:
                    load_settings()
            assert caught.value.field == variable


_NEAR = ("FASTSPLAT_PORT", "FASTSPLAT_HTTP_PORT__X", "FASTSPLAT_CAPTURE__MAX_IMAGES__X", "FASTSPLAT_JOBS__BEAT_S")


@pytest.mark.parametrize("variable", [*_NEAR, "FASTSPLAT_JOBS__MAX_STARTS", "FASTSPLAT_HTTP_PORT"])
def test_a_variable_that_sets_nothing_is_refused_by_name_and_not_told(
    variable: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv(variable, "secret")
    with pytest.raises(InvalidInputError, match="is no setting" if variable in _NEAR else None) as caught:
        load_settings()
    assert caught.value.field == variable and variable in caught.value.message and caught.value.hint
    assert "secret" not in str(caught.value)


_VARIABLES = {f"{ENV_PREFIX}{name.upper()}" for name in _names()}


@pytest.mark.parametrize("group", ["", *_GROUPS])
def test_a_misspelt_variable_is_refused_and_the_nearest_name_offered(
    group: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """One letter is lost from the middle of every field of every group."""
    start = f"{ENV_PREFIX}{group.upper()}__" if group else ENV_PREFIX
    fields = [name for name in _VARIABLES if name.startswith(start) and "__" not in name.removeprefix(start)]
    assert fields
    for variable in fields:
        at = (len(start) + len(variable)) // 2
        misspelt = variable[:at] + variable[at + 1 :]
        with monkeypatch.context() as patched:
            patched.setenv(misspelt, "7")
            with pytest.raises(InvalidInputError, match="is no setting") as caught:
                load_settings()
        assert caught.value.field == misspelt
        near = re.findall(r"Did you mean (\w+)\?", caught.value.hint)[0]
        assert near == variable or _likeness(misspelt, near) >= _likeness(misspelt, variable)


def _likeness(first: str, second: str) -> float:
    return SequenceMatcher(None, second.removeprefix(ENV_PREFIX), first.removeprefix(ENV_PREFIX)).ratio()


@pytest.mark.parametrize("group", _GROUPS)
def test_a_misspelt_field_in_a_group_as_json_is_refused(group: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(f"FASTSPLAT_{group.upper()}", '{"max_imags": 7}')
    with pytest.raises(InvalidInputError, match="is no setting") as caught:
        load_settings()
    assert caught.value.field == f"FASTSPLAT_{group.upper()}__MAX_IMAGS" and "Did you mean" in caught.value.hint


@pytest.mark.parametrize(
    ("variable", "value"),
    [
        *((variable, "x") for variable in sorted(OTHER_VARIABLES)),
        ("FASTSPLAT_SERVICE_HOST", "10.0.0.7"),
        ("FASTSPLAT_SERVICE_PORT_HTTP", "8000"),
        ("FASTSPLAT_WORKER_SERVICE_HOST", "10.0.0.8"),
        ("FASTSPLAT_PORT", "tcp://10.0.0.7:8000"),
        ("FASTSPLAT_PORT_8000_TCP_ADDR", "10.0.0.7"),
        ("FAST_SPLAT", "x"),
    ],
)
def test_variables_of_others_are_let_be(variable: str, value: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Kubernetes sets some for each service, also for one that is called fastsplat."""
    monkeypatch.setenv(variable, value)
    assert load_settings() is not None


def test_models_are_found_by_the_setting_then_near_then_at_the_user_s(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("FASTSPLAT_MODELS", raising=False)
    monkeypatch.setenv("XDG_DATA_HOME", str(tmp_path / "home"))
    monkeypatch.chdir(tmp_path)
    data = tmp_path / "data"
    assert Settings(data_dir=data).models == tmp_path / "home" / "fastsplat" / "models"  # where pull makes it
    (tmp_path / ".models").mkdir()
    assert Settings(data_dir=data).models == Path(".models")
    (data / "models").mkdir(parents=True)
    assert Settings(data_dir=data).models == data / "models"
    monkeypatch.setenv("FASTSPLAT_MODELS", "/elsewhere")
    assert Settings(data_dir=data).models == Path("/elsewhere")


def test_a_group_that_is_not_json_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("FASTSPLAT_JOBS", "{secret")
    with pytest.raises(InvalidInputError, match="jobs") as caught:
        load_settings()
    assert "secret" not in str(caught.value)


def test_a_subclass_must_name_its_section() -> None:
    with pytest.raises(TypeError, match="section"):

        class _Nameless(SettingGroup):
            value: int = Field(1)


def test_every_variable_that_code_or_documents_name_is_a_setting() -> None:
    """A renamed setting must not live on in an error's text, a document or a compose file."""
    variables = {name.upper() for name in _names()} | {name.removeprefix(ENV_PREFIX) for name in OTHER_VARIABLES}
    listed = subprocess.run(["git", "ls-files"], cwd=ROOT, capture_output=True, text=True, check=True).stdout.split()
    texts = [
        path for path in map(ROOT.joinpath, listed)
        if path.suffix in (".py", ".md", ".yaml", ".toml", ".sh", ".cpp") or path.name in ("Makefile", "run")
    ]  # fmt: skip
    unknown = {}
    for path in texts:
        if not path.exists() or path == Path(__file__):
            continue
        for name in re.findall(rf"\b{ENV_PREFIX}([A-Z0-9_]+)", path.read_text()):
            name = name.removesuffix("_FILE")  # a file that holds the value
            if name not in variables and not (name.endswith("_") and any(var.startswith(name) for var in variables)):
                unknown.setdefault(f"{ENV_PREFIX}{name}", []).append(str(path.relative_to(ROOT)))
    assert not unknown
