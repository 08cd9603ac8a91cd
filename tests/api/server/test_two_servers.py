"""Two servers behind a proxy, with a database and a bucket in common and nothing else: to a client they are one."""

from __future__ import annotations

import itertools
import threading
import uuid
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import fsspec
import httpx
import pytest

from fastsplat.service.application.service import SceneService, open_service
from fastsplat.service.perception.perception_settings import PerceptionSettings
from fastsplat.service.perception.text.text_encoders import open_text_encoder
from fastsplat.service.query.query_settings import QuerySettings
from fastsplat.service.settings import Settings
from fastsplat.service.store.artefact_settings import ArtefactSettings
from fastsplat_client import Client, Retry, Subscription
from fastsplat_contract.errors import UnauthenticatedError
from fastsplat_contract.messages.queries import QueryRequest
from fastsplat_contract.messages.scenes import Color, Edit
from tests.api.made_scene import ENCODER, made_scene, turned, write_words
from tests.api.served import on_free_ports
from tests.api.server_process import ServerProcess, server_process
from tests.api.uploaded import zipped
from tests.at_once import at_once
from tests.postgres import PostgresServer
from tests.scenes import store_scene


class _Proxy(httpx.BaseTransport):
    """Sends each request to the next server."""

    def __init__(self, urls: Sequence[str]) -> None:
        self._next = itertools.cycle(httpx.HTTPTransport() for _ in urls)
        self._urls = itertools.cycle(map(httpx.URL, urls))
        self._lock = threading.Lock()

    def handle_request(self, request: httpx.Request) -> httpx.Response:
        with self._lock:
            url, transport = next(self._urls), next(self._next)
        request.url = request.url.copy_with(host=url.host, port=url.port)
        return transport.handle_request(request)


@dataclass(frozen=True)
class _Cluster:
    """The servers, and a third machine with the same database and bucket, which serves nobody."""

    servers: tuple[ServerProcess, ServerProcess]
    machine: SceneService
    settings: tuple[Settings, Settings]

    def key(self, role: str = "editor") -> str:
        return self.machine.admin.keys.create("Ada", role)[1]  # type: ignore[arg-type]

    @contextmanager
    def clients(self, key: str) -> Iterator[tuple[Client, Client]]:
        """One of each server."""
        with ExitStack() as opened:
            first, second = (
                opened.enter_context(
                    Client(server.url, key=key, grpc_target=server.grpc_target, retry=Retry(tries=1), timeout_s=600.0)
                )
                for server in self.servers
            )
            yield first, second

    def behind_proxy(self, key: str) -> Client:
        proxy = _Proxy([server.url for server in self.servers])
        return Client("http://proxy", key=key, transport=proxy, piece_bytes=3_000, timeout_s=600.0)


@pytest.fixture(scope="module")
def cluster(postgres: PostgresServer, s3: str, tmp_path_factory: pytest.TempPathFactory) -> Iterator[_Cluster]:
    folder, bucket = tmp_path_factory.mktemp("cluster"), f"b{uuid.uuid4().hex}"
    fsspec.filesystem("s3", endpoint_url=s3, skip_instance_cache=True).mkdir(bucket)
    with postgres.database() as url, ExitStack() as opened:

        def settings(name: str) -> Settings:
            (folder / name).mkdir()
            write_words(folder / name / "models")
            return on_free_ports(
                auth="on",
                data_dir=folder / name / "data",
                models=folder / name / "models",
                database_url=url,
                artefacts=ArtefactSettings(url=f"s3://{bucket}/place", endpoint_url=s3),
                perception=PerceptionSettings(text_encoder=ENCODER, open_set_detector="grounding_dino_tiny"),
                query=QuerySettings(backend="cpu", threshold=0.5, exact_threshold=0.95),
            )

        machine = opened.enter_context(open_service(settings("apart")))
        machine.admin.keys.create("operator", "operator")  # else each server would make the first
        ours = settings("here"), settings("there")
        with pytest.MonkeyPatch.context() as patch:

            def started(of: Settings) -> ServerProcess:
                patch.setenv("HOME", str(of.data_dir.parent))
                return opened.enter_context(server_process(of))

            yield _Cluster((started(ours[0]), started(ours[1])), machine, ours)


@pytest.fixture
def scene_id(cluster: _Cluster) -> Iterator[str]:
    """A scene that the third machine has put into the bucket."""
    scene = made_scene(open_text_encoder(ENCODER, cluster.settings[0].models))
    scene_id, blobs = store_scene(cluster.machine._store, scene), cluster.machine._store.blobs
    version = cluster.machine.versions.resolve(scene_id)
    blobs.publish(blobs.version(scene_id, version).rename(blobs.root / "made"), scene_id, version)
    yield scene_id
    cluster.machine.delete_scene(scene_id)


def _named(number: int, name: str) -> list[Edit]:
    return [Edit("name", object_ids=(number,), name=name)]


def test_an_edit_on_one_is_in_the_next_answer_of_the_other(cluster: _Cluster, scene_id: str) -> None:
    def found(client: Client) -> tuple[str, tuple[int, ...]]:
        (answer,) = client.query(scene_id, "violin", outputs=("objects",))
        return answer.version, tuple(obj.id for obj in answer.objects)

    with cluster.clients(cluster.key()) as (first, second):
        before = found(first)
        assert found(second) == before
        for editor, reader in ((first, second), (second, first)):
            edited = editor.edit_scene(scene_id, _named(1, "violin")).version
            assert found(reader) == found(editor) and found(reader)[0] == edited
            assert found(reader)[1] != before[1]
            assert reader.undo_edit(scene_id).version == before[0]
            assert found(editor) == before
        assert [version.version for version in first.versions(scene_id)] == [
            version.version for version in second.versions(scene_id)
        ]


def test_edits_of_one_scene_wait_for_each_other_on_both(cluster: _Cluster, scene_id: str) -> None:
    """None is refused: eight at once on each are one line of sixteen versions."""
    with cluster.clients(cluster.key()) as clients:
        edits = [Edit("recolor", "mug", color=Color(number / 16, 0.0, 0.0)) for number in range(16)]
        calls = [partial(clients[number % 2].edit_scene, scene_id, [edit]) for number, edit in enumerate(edits)]
        edited = at_once(*calls)
        assert [getattr(outcome, "edits", outcome) for outcome in edited] == [(edit,) for edit in edits]
        stored = clients[0].versions(scene_id)
    assert {version.version for version in stored[1:]} == {outcome.version for outcome in edited}
    assert [version.parent for version in stored[1:]] == [version.version for version in stored[:-1]]


def test_a_stream_on_each_has_the_edit_of_the_other_at_its_next_pose(cluster: _Cluster, scene_id: str) -> None:
    question = Subscription(QueryRequest(scene_id, ("violin",)))
    gates = threading.Semaphore(0), threading.Semaphore(0)
    poses = [iter(lambda gate=gate: gate.acquire() and turned(0.1), False) for gate in gates]
    with cluster.clients(cluster.key()) as clients:
        streams = [client.stream_query(question, of_one) for client, of_one in zip(clients, poses, strict=True)]
        version = clients[0].scene(scene_id).version
        for editor in (None, *clients):
            if editor is not None:
                version = editor.edit_scene(scene_id, _named(2, "violin")).version
            for gate in gates:
                gate.release()
            assert [answer.version for stream in streams for answer in next(stream).answers] == [version, version]


def test_a_key_that_one_revokes_the_other_refuses_and_ends_its_stream(cluster: _Cluster, scene_id: str) -> None:
    secret = cluster.key("reader")
    with cluster.clients(cluster.key("admin")) as (admin, _), cluster.clients(secret) as (_, reader):
        assert reader.query(scene_id, "mug")
        question, more = Subscription(QueryRequest(scene_id, ("mug",))), threading.Event()
        stream = reader.stream_query(question, (turned(0.1) for _ in iter(lambda: more.wait(600), False)))
        threading.Thread(target=admin.keys.revoke, args=(secret.split("_")[1],)).start()
        with pytest.raises(UnauthenticatedError):
            list(stream)
        more.set()
        with pytest.raises(UnauthenticatedError):
            reader.query(scene_id, "mug")


def test_pieces_reach_the_servers_in_turn_and_are_one_capture(cluster: _Cluster, tmp_path: Path) -> None:
    (tmp_path / "room.zip").write_bytes(zipped(3))
    with cluster.behind_proxy(cluster.key()) as client:
        operation = client.create_scene(tmp_path / "room.zip", name="in pieces")
        record = cluster.machine._store.scenes.operation(operation.id)
        assert {client.operation(operation.id).state for _ in range(4)} == {"QUEUED"}
    folder = cluster.machine._store.blobs.fetch_upload(record.upload_id)
    assert len(list(folder.rglob("*.jpg"))) == 3
    left = [list(settings.data_dir.glob("uploads/*")) for settings in cluster.settings]
    assert left == [[], []]  # nothing of it stays on a server
    cluster.machine.delete_scene(operation.scene_id)
