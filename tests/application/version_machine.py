"""Concurrent calls on a scene's versions: some order in `version_model` must explain the answers and what is stored."""

from __future__ import annotations

import itertools
import json
import shutil
import threading
import uuid
from collections.abc import Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from random import Random

import numpy as np
from hypothesis import HealthCheck, Phase, settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, precondition, rule, run_state_machine_as_test

from fastsplat.service.application.editing.versions import Versions
from fastsplat.service.perception.results import TextEncoder
from fastsplat.service.query.query_settings import QuerySettings
from fastsplat.service.scene.artefact.scene import SH_C0
from fastsplat.service.scene.artefact.scene_files import read_scene
from fastsplat.service.settings import CallSettings
from fastsplat.service.store.rows.records import NewJob
from fastsplat.service.store.store import Store
from fastsplat.workers.job.claimed_job import ClaimedJob
from fastsplat.workers.kinds.job_kinds import KINDS
from fastsplat_contract.errors import ConflictError, NotFoundError
from fastsplat_contract.messages.scenes import Color, Edit
from tests.api.made_scene import LABELS
from tests.application.version_model import (
    Acknowledged,
    Answer,
    Call,
    Content,
    EditCall,
    History,
    JobCall,
    Known,
    RestoreCall,
    StepCall,
)
from tests.scenes import labelled_scene, store_scene

LIMIT = 5  # versions that servers keep of a scene
_COLORS = 16
_AT_ONCE = 4
_REQUESTS = 6
_KINDS = ("edit", "edit", "edit again", "undo", "undo", "redo", "restore", "job")
_FOLDERS = {"shared": "scenes/{}/*", "apart": "scenes/{}/*/manifest.json"}


@dataclass
class Place:
    """Two servers of one database, and the store of each."""

    servers: tuple[Versions, Versions]
    stores: tuple[Store, Store]
    published: Path
    encoder: TextEncoder
    apart: bool = False


class VersionMachine(RuleBasedStateMachine):
    """The calls; `place` is set by whoever runs it."""

    place: Place

    @initialize()
    def make_scene(self) -> None:
        ids = np.repeat(np.arange(1, len(LABELS) + 1), 2)
        means, black = np.arange(len(ids) * 3.0).reshape(-1, 3), _sh(np.zeros(len(ids)))
        templates = QuerySettings().templates
        scene = labelled_scene(means, ids, LABELS, sh=black, encoder=self.place.encoder, templates=templates)
        store = self.place.stores[0]
        self.scene_id = store_scene(store, scene)
        version = store.scenes.scene(self.scene_id).version
        source = store.blobs.version(self.scene_id, version).rename(store.blobs.root / uuid.uuid4().hex)
        store.blobs.publish(source, self.scene_id, version)
        self.pool = ThreadPoolExecutor(_AT_ONCE)
        (only,) = self.place.servers[0].all(self.scene_id)
        self.histories = [History({only.version: Known("", (0,) * len(LABELS))}, only.version, LIMIT)]
        self.stale = only.version

    @rule(seed=st.integers(0, 2**32), count=st.integers(2, _AT_ONCE))
    def call_alike(self, seed: int, count: int) -> None:
        """Calls of one kind, which mostly exclude each other."""
        random = Random(seed)
        self._call([*random.choices(_KINDS, k=1) * count], random)

    @rule(seed=st.integers(0, 2**32), count=st.integers(1, _AT_ONCE))
    def call_any(self, seed: int, count: int) -> None:
        """Calls of several kinds."""
        random = Random(seed)
        self._call(random.choices(_KINDS, k=count), random)

    def _call(self, kinds: Sequence[str], random: Random) -> None:
        current = self.histories[0].current
        calls = [self._some(kind, random) for kind in kinds]
        self._check(calls, self._at_once(calls))
        self.stale = current

    @rule(count=st.integers(1, LIMIT))
    def edit_on(self, count: int) -> None:
        for number in range(count):
            calls: list[Call] = [EditCall(number % len(LABELS), number, uuid.uuid4().hex)]
            self._check(calls, self._at_once(calls))

    @rule()
    @precondition(lambda self: len(self.histories[0].lineage()) > 2)
    def undo_all_and_redo_all(self) -> None:
        count = len(self.histories[0].lineage()) - 1
        for action in (*["undo"] * count, *["redo"] * count):
            calls: list[Call] = [StepCall(action, "")]
            self._check(calls, self._at_once(calls))

    def teardown(self) -> None:
        if hasattr(self, "pool"):
            self.pool.shutdown()
            self.place.stores[0].scenes.delete_scene(self.scene_id)

    def _some(self, kind: str, random: Random) -> Call:
        """Which versions there are is not Hypothesis's to know; so it draws a seed, not the calls."""
        history = self.histories[0]
        target = random.choice(list(history.versions))
        (expected,) = random.choices(("", history.current, self.stale), (2, 4, 1))
        if kind == "edit":
            return EditCall(random.randrange(len(LABELS)), random.randrange(_COLORS), uuid.uuid4().hex)
        if kind == "edit again":
            number = random.randrange(2 * _REQUESTS)  # two requests of each id
            return EditCall(number % len(LABELS), number % _COLORS, f"request{number % _REQUESTS}")
        if kind == "restore":
            return RestoreCall(target, expected)
        if kind == "job":
            return JobCall(expected or history.current)
        return StepCall("undo" if kind == "undo" else "redo", expected)

    def _at_once(self, calls: Sequence[Call]) -> list[Answer]:
        barrier = threading.Barrier(len(calls))

        def answer(number: int) -> Answer:
            job = self._job(calls[number], number % 2)
            barrier.wait()
            try:
                result = self._answer(calls[number], number % 2, job)
            except ConflictError:
                return "conflict"
            except NotFoundError:
                return "not found"
            return result

        return list(self.pool.map(answer, range(len(calls))))

    def _answer(self, call: Call, number: int, job: ClaimedJob | None) -> Acknowledged:
        server = self.place.servers[number]
        if isinstance(call, EditCall):
            color = Color(call.color / _COLORS, 0.0, 0.0)
            info = server.edit(self.scene_id, [Edit("recolor", label=LABELS[call.label], color=color)], call.request_id)
        elif isinstance(call, RestoreCall):
            info = server.restore(self.scene_id, call.version, call.expected)
        elif isinstance(call, StepCall):
            info = (server.undo if call.action == "undo" else server.redo)(self.scene_id, call.expected)
        else:
            assert job is not None
            try:
                KINDS["look_again"].publish(job, "naming")
            except ConflictError:
                job.drop_result("naming")
                raise
            return Acknowledged(job.run_id, call.parent)
        assert info.current or isinstance(call, EditCall)  # one that was made before may have been edited since
        return Acknowledged(info.version, info.parent)

    def _job(self, call: Call, number: int) -> ClaimedJob | None:
        """A job whose result is a copy of the version that it began with."""
        if not isinstance(call, JobCall):
            return None
        store, name = self.place.stores[number], uuid.uuid4().hex
        store.scenes.add_job(NewJob(self.scene_id, name, "", "", "d", "", {}, "look_again", {"texts": ["mug"]}))
        claim = store.jobs.claim(name)
        assert claim is not None
        job = ClaimedJob(store, claim, CallSettings(max_versions=LIMIT))
        folder = job.folder / "naming"
        record = store.scenes.scene(self.scene_id)
        parent = store.blobs.fetch_version(self.scene_id, call.parent)  # which an earlier call may have removed
        shutil.copytree(parent or store.blobs.version(self.scene_id, record.version), folder)
        summary = {
            "result": {}, "parent": call.parent, "gaussians": record.gaussians,
            "objects": record.objects, "dictionary": list(record.dictionary),
        }  # fmt: skip
        (folder / "summary.json").write_text(json.dumps(summary))
        return job

    def _check(self, calls: Sequence[Call], answers: Sequence[Answer]) -> None:
        """Keep the histories that explain the answers and what is stored."""
        listed = [server.all(self.scene_id) for server in self.place.servers]
        assert listed[0] == listed[1]
        rows = [(version.version, version.parent) for version in listed[0]]
        (current,) = [version.version for version in listed[0] if version.current]
        explained = {}
        for history in self.histories:
            for order in itertools.permutations(zip(calls, answers, strict=True)):
                after = _after(history, order)
                stored = after and [(name, known.parent) for name, known in after.versions.items()]
                if after and stored == rows and after.current == current:
                    explained[repr(after)] = after
        assert explained, (self.histories, list(zip(calls, answers, strict=True)), rows, current)
        self.histories = list(explained.values())
        folders = self.place.published.glob(_FOLDERS["apart" if self.place.apart else "shared"].format(self.scene_id))
        published = {path.parent.name if self.place.apart else path.name for path in folders}
        assert published == {name for name, _ in rows}
        for store in self.place.stores:
            content = _content(store, self.scene_id, current)
            assert {history.versions[current].content for history in self.histories} == {content}


def _after(history: History, order: Iterable[tuple[Call, Answer]]) -> History | None:
    after: History | None = history
    for call, answer in order:
        after = after and after.after(call, answer)
    return after


def _sh(colors: np.ndarray) -> np.ndarray:
    """[G, 1, 3] of so many sixteenths of red."""
    rgb = np.stack([colors / _COLORS, np.zeros(len(colors)), np.zeros(len(colors))], axis=1)
    return ((rgb - 0.5) / SH_C0)[:, None, :].astype(np.float32)


def _content(store: Store, scene_id: str, version: str) -> Content:
    """What the files of a version show."""
    folder = store.blobs.fetch_version(scene_id, version)
    assert folder is not None
    store.blobs.check_version(folder)
    red = read_scene(folder / "artefact").gaussians.sh[::2, 0, 0] * SH_C0 + 0.5
    return tuple(round(float(value) * _COLORS) for value in red)


def run(place: Place, scenes: int, steps: int) -> None:
    """So many scenes, each with so many steps of one to a dozen calls."""
    machine = type("Machine", (VersionMachine,), {"place": place})
    # Without an attempt to make a failure smaller: what happens at the same moment does not happen again.
    phases, checks = (Phase.generate,), list(HealthCheck)
    run_state_machine_as_test(
        machine,
        settings=settings(
            max_examples=scenes, stateful_step_count=steps, database=None, phases=phases,
            suppress_health_check=checks,
        ),
    )  # fmt: skip
