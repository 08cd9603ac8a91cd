"""Whatever is called at once on two servers: what is acknowledged is there, and undo, redo and restore are exact."""

from __future__ import annotations

from contextlib import ExitStack
from pathlib import Path

from fastsplat.service.application.service import open_service
from fastsplat.service.perception.text.open_text_encoder import open_text_encoder
from fastsplat.service.query.query_settings import QuerySettings
from fastsplat.service.settings import CallSettings, Settings
from fastsplat.service.store.artefact_settings import ArtefactSettings
from tests.api.made_scene import ENCODER, write_words
from tests.application.version_machine import LIMIT, Place, run


def test_every_acknowledged_call_is_in_the_one_history_of_its_scene(tmp_path: Path, database_url: str) -> None:
    """SQLite: two servers of one data folder. PostgreSQL: two machines that share that and an object store alone."""
    objects = tmp_path / "objects"
    artefacts = ArtefactSettings(url=objects.as_uri() if database_url else "")
    write_words(tmp_path / "models")
    encoder = open_text_encoder(ENCODER, tmp_path / "models")
    with ExitStack() as stack:
        first, second = (
            stack.enter_context(
                open_service(
                    Settings(
                        data_dir=tmp_path / ("data", "elsewhere")[bool(database_url) and number],
                        database_url=database_url,
                        artefacts=artefacts,
                        models=tmp_path / "models",
                        query=QuerySettings(backend="reference"),
                        calls=CallSettings(max_versions=LIMIT),
                    )
                )
            )
            for number in range(2)
        )
        published = objects if database_url else tmp_path / "data"
        stores = first._store, second._store
        run(Place((first.versions, second.versions), stores, published, encoder, bool(database_url)), scenes=4, steps=8)
