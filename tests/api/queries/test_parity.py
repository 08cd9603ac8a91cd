"""REST = gRPC = in process."""

from __future__ import annotations

import random
from collections.abc import Mapping
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
import pytest

from fastsplat.service.application.service import SceneService
from fastsplat.service.settings import Settings
from fastsplat_contract.errors import FastSplatError
from fastsplat_contract.geometry.camera import Camera, PosedCamera
from fastsplat_contract.geometry.places import Alignment
from fastsplat_contract.geometry.poses import pose_of
from fastsplat_contract.masks import decode_mask3d
from fastsplat_contract.messages.queries import Answer, QueryRequest
from fastsplat_contract.messages.scenes import Edit
from fastsplat_contract.v1 import fastsplat_pb2 as pb
from tests.api.call_examples import BOUNDS_OF_THE_URL, EXAMPLES, RED, UP, Example
from tests.api.calls import CALLS, ELSEWHERE, Refused, in_process, over_grpc, over_rest
from tests.api.clients import assert_same, client_of, outcome
from tests.api.made_scene import KINDRED, LABELS, STRANGERS, add_known_name, add_scene, turned
from tests.api.served import Faces, rest_refusal
from tests.api.training_job import add_cancelled_job, add_training_job
from tests.api.upright_scene import add_upright_scene

_VIEWS = ("front.png", "photos/left side & ü.png", "a/b/right.png")
_WORDS = (*LABELS, *(word for words in KINDRED.values() for word in words), *STRANGERS)
_AWAY = PosedCamera(turned(0).camera, np.diag([-1.0, 1.0, -1.0, 1.0]))
_BESIDE = "the object left of the ball"
_HUGE = PosedCamera(Camera(5_000, 10, 45.0, 45.0, 24.0, 5.0), np.eye(4))


def _questions(scene_id: str, count: int) -> list[QueryRequest]:
    """Drawn by a fixed seed: all that a request can hold, and in every fourth the next thing that must be refused."""
    rng = random.Random(11)
    requests = []
    for number in range(count):
        outputs = rng.sample(["mask2d", "mask3d", "objects"], rng.choice([0, 0, 1, 2, 3]))
        words = rng.choices(_WORDS, k=rng.choice([1, 1, 2, 3]))
        texts = tuple(rng.choice([w, w.upper(), f" {w} ", f"{w}s", f"where is the {w}?"]) for w in words)
        request: dict[str, object] = {"scene_id": scene_id, "texts": texts, "outputs": frozenset(outputs)}
        if "mask2d" in outputs:
            cameras = [_AWAY, *(turned(angle) for angle in (-0.5, -0.2, 0.1, 0.4))]
            request |= {"cameras": tuple(rng.sample(cameras, rng.randrange(2)))}
            request |= {"views": tuple(rng.sample(_VIEWS, 1)), "mask2d_encoding": rng.choice(["rle", "png"])}
        elif rng.random() < 0.1:
            request |= {"scene_id": ""}
        if "mask3d" in outputs:
            request |= {"mask3d_encoding": rng.choice(["bits", "runs", "indices"])}
            if len(texts) == 1 and rng.random() < 0.3:
                request |= {"mask3d_encoding": "ply"}
        for name, choices in _CHOICES.items():
            if rng.random() < 0.15:
                request |= {name: rng.choice(choices)}
        if number % 4 == 0:
            request |= _BAD[number // 4 % len(_BAD)]
        requests.append(QueryRequest(**request))
    return requests


_CHOICES: dict[str, list[object]] = {
    "negatives": [("object",), ("stuff", "texture")],
    "templates": [("{}",), ("a photo of a {}",)],
    "coverage": [0.5, 0.99],
    "max_matches": [1, 2, -1],
}
_BAD: list[dict[str, object]] = [
    {"texts": ()},
    {"texts": ("mug", " ")},
    {"texts": ("x" * 1_001,)},
    {"texts": ("mug",) * 65},
    {"scene_id": "none"},
    {"scene_id": "ü\0"},
    {"version": "none"},
    {"scene_id": "", "version": "1"},
    {"scene_id": "", "views": ("front.png",), "outputs": frozenset({"mask2d"})},
    {"outputs": frozenset({"mask2d"}), "cameras": (), "views": ()},
    {"outputs": frozenset({"mask2d"}), "views": ("none.png",)},
    {"outputs": frozenset({"mask2d"}), "cameras": (_HUGE,)},
    {"outputs": frozenset({"mask2d"}), "cameras": (turned(0.0),) * 65},
    {"outputs": frozenset({"mask2d"}), "cameras": (replace(turned(0.0), frame_id="kitchen"),)},
    {"coverage": 1.5},
    {"coverage": -0.1},
    {"coverage": 0.0},
    {"coverage": 1.0},
    {"templates": ("no slot",)},
    {"negatives": (" ",)},
    {"texts": ("mug", "ball"), "outputs": frozenset({"mask3d"}), "mask3d_encoding": "ply"},
    {"texts": (_BESIDE,), "asker_view": "none.png"},
    {"texts": (_BESIDE,), "asker_view": "front.png", "asker": pose_of(np.eye(4))},
    {"texts": (_BESIDE,), "asker_view": "front.png", "scene_id": ""},
]


def test_200_questions_get_the_same_answer_from_both_faces_and_in_process(
    faces: Faces, service: SceneService, scene_id: str
) -> None:
    answered: list[Answer] = []
    refused: set[str] = set()
    with client_of(faces) as client:
        for number, request in enumerate(_questions(scene_id, 200)):
            truth = outcome(lambda request=request: service.answers.query(request).answers)
            if request.scene_id or not (request.outputs & {"mask2d"} or request.asker_view):  # GET /query knows less
                assert_same(outcome(partial(client.ask, request)), truth)
            assert_same(outcome(partial(client.ask, request, protocol="gRPC")), truth)
            assert number % 4 or not isinstance(truth[0], Answer), request
            if isinstance(truth[0], Answer):
                answered += truth
            else:
                assert issubclass(truth[0], FastSplatError) and truth[2]["field"]
                refused.add(truth[2]["field"])
    # The questions are varied.
    assert {result.outcome for result in answered} >= {"here", "probably_here", "not_here"}
    masks = [mask for result in answered for mask in result.masks]
    assert len(masks) > sum(mask.area > 0 for mask in masks) > 5
    assert {bool(mask.png) for mask in masks} == {True, False}
    assert sum(len(result.objects or ()) for result in answered) > 5
    assert len(answered) > 150 and refused >= {"asker_view", "cameras[0].frame_id", "scene_id"}


def test_every_encoding_of_a_mask_is_the_same_mask(faces: Faces, service: SceneService, scene_id: str) -> None:
    with client_of(faces) as client:
        expected = client.mask3d(scene_id, "mug")
        assert expected[:60].all() and not expected[60:].any()  # the mug's rows come first
        for encoding in ("bits", "runs", "indices"):
            (answer,) = client.query(scene_id, "mug", outputs=["mask3d"], mask3d_encoding=encoding)
            assert (decode_mask3d(answer.mask3d or b"", encoding, answer.gaussians) == expected).all()
            params = {"text": "mug", "encoding": encoding}
            packed = faces.rest.get(f"/v1/scenes/{scene_id}/mask3d.bin", params=params)
            assert packed.content == answer.mask3d
            facts = (packed.headers["x-gaussian-count"], packed.headers["x-scene-version"])
            assert facts == (str(len(expected)), answer.version)
        (answer,) = client.query(scene_id, "mug", outputs=["mask3d", "objects"], mask3d_encoding="ply")
        assert answer.mask3d == client.export(scene_id, objects=answer.object_ids)
        (rle,) = client.query(scene_id, "mug", views=_VIEWS, outputs=["mask2d"])
        (png,) = client.query(scene_id, "mug", views=_VIEWS, outputs=["mask2d"], mask2d_encoding="png")
        for first, second in zip(rle.masks, png.masks, strict=True):
            assert (first.array() == second.array()).all() and first.area == first.array().sum() == second.area


class _Places:
    """Scenes and jobs that examples are about, each made when it is asked for."""

    def __init__(self, service: SceneService, settings: Settings, scene_id: str) -> None:
        self._service = service
        self._settings = settings
        self._shared = scene_id
        self._cached: dict[str, dict[str, str]] = {}

    def of(self, of: str) -> dict[str, str]:
        """Ids of what is called so; anew where examples change it."""
        if of not in ("scene", "done", "upright", "table"):
            return self._new(of)
        if of not in self._cached:
            self._cached[of] = self._new(of)
        return self._cached[of]

    def _new(self, of: str) -> dict[str, str]:
        if of == "nothing":
            return {"scene_id": "none", "operation_id": "none", "name_id": "none"}
        if of in ("training", "cancelled"):
            if of == "cancelled":
                return {"operation_id": add_cancelled_job(self._service, "bad.jpg")}
            return {"operation_id": add_training_job(self._service).operation.id}
        if of == "done":
            return {"operation_id": self._service.get_scene(self._shared).operation_id}
        if of == "scene":
            return {"scene_id": self._shared}
        if of in ("upright", "table"):
            names = {"table": ("dining table",)}.get(of, ())
            return {"scene_id": add_upright_scene(self._service, self._settings, *names)}
        return {"scene_id": self._changed(of)}

    def _changed(self, of: str) -> str:
        scene_id = add_scene(self._service, self._settings, "own")
        if of in ("edited", "undone"):
            self._service.versions.edit(scene_id, [Edit("recolor", label="mug", color=RED)])
        if of == "unnamed":
            self._service.versions.edit(scene_id, [Edit("unname", object_ids=(1, 2, 3))])
        if of == "undone":
            self._service.versions.undo(scene_id)
        if of == "aligned":
            alignment = Alignment("map", UP)
            self._service.versions.edit(scene_id, [Edit("align", alignment=alignment)])
        if of == "named":
            add_known_name(self._service, scene_id)
        return scene_id


@pytest.fixture(scope="module")
def places(service: SceneService, api_settings: Settings, scene_id: str) -> _Places:
    return _Places(service, api_settings, scene_id)


def test_every_call_has_an_example_or_is_said_to_be_elsewhere() -> None:
    assert {example.call for example in EXAMPLES} == CALLS.keys() - ELSEWHERE
    assert CALLS.keys() >= ELSEWHERE
    assert CALLS.keys() == {method.name for method in pb.DESCRIPTOR.services_by_name["SceneService"].methods}


@pytest.mark.parametrize("example", EXAMPLES, ids=lambda example: example.call)
def test_a_call_says_the_same_over_both_protocols_and_in_process(
    faces: Faces, service: SceneService, places: _Places, example: Example
) -> None:
    ids = places.of(example.of)
    named = {name: value for name, value in ids.items() if f"{{{name}}}" in CALLS[example.call].route}
    answers = []
    for ask in (in_process, over_rest, over_grpc):
        place = faces if ask is not in_process else service
        answers.append(ask(place, example.call, named, example.request))
        _take_back(service, example.call, ids)
    truth, *copies = (_timeless(answer) for answer in answers)
    if example.refused is None:
        assert not isinstance(truth, Refused), truth
        for copy in copies:
            assert_same(copy, truth)
        return
    reason, field = example.refused
    for refused in answers:
        assert isinstance(refused, Refused), refused
        assert refused.reason == reason and refused.details.get("field", "").endswith(field), refused
    if (example.call, field) not in BOUNDS_OF_THE_URL:
        assert answers[0] == answers[1] == answers[2]


def _timeless(answer: Any) -> Any:
    """An answer without the moment of it."""
    return replace(answer, updated_at=None) if hasattr(answer, "updated_at") else answer


def _take_back(service: SceneService, call: str, ids: Mapping[str, str]) -> None:
    """What would make the next protocol's answer another one."""
    if call == "UndoEdit" and len(service.versions.all(ids["scene_id"])) > 1:
        service.versions.redo(ids["scene_id"])
    if call == "RedoEdit" and len(service.versions.all(ids["scene_id"])) > 1:
        service.versions.undo(ids["scene_id"])
    if call == "RetryOperation" and ids["operation_id"] != "none":
        service.cancel_operation(ids["operation_id"])


@pytest.mark.parametrize(
    ("name", "items", "of"),
    [
        *((name, items, "scene") for name, items in (("ListLabels", "labels"),)),
        *((name, items, "scene") for name, items in (("ListObjects", "objects"), ("ListPhotos", "photos"))),
        ("ListDetections", "detections", "upright"),
    ],
)
def test_pages_make_the_whole(faces: Faces, places: _Places, name: str, items: str, of: str) -> None:
    ids = places.of(of)
    for ask in (over_rest, over_grpc):
        whole = getattr(ask(faces, name, ids, {}), items)
        found: list[Any] = []
        token = ""
        while len(found) < len(whole):
            page = ask(faces, name, ids, {"page_size": 1, "page_token": token})
            assert len(getattr(page, items)) == 1 and (page.next_page_token != "") == (len(found) + 1 < len(whole))
            found, token = [*found, *getattr(page, items)], page.next_page_token
        assert_same(tuple(found), whole)
        assert len(whole) > 1


def test_every_parameter_of_a_question_in_an_address_is_that_of_the_body(faces: Faces, scene_id: str) -> None:
    question = {"text": "the object left of the ball", "scene": scene_id}
    for changed, plain in (
        ({"max_matches": 1}, question),
        ({"asker_view": "front.png"}, question),
        ({"view": ["front.png"], "outputs": ["mask2d"], "mask2d_encoding": "png"}, question),
        ({"outputs": ["mask3d", "objects"]}, question),
        ({"outputs": ["mask3d"], "mask3d_encoding": "runs"}, {**question, "outputs": ["mask3d"]}),
        ({"coverage": 0.5, "outputs": ["objects"]}, {**question, "text": "mug", "outputs": ["objects"]}),
        ({"negatives": ["moon"], "text": "beaker"}, {**question, "text": "beaker"}),
        ({"templates": ["a photo of a {}"], "text": "beaker"}, {**question, "text": "beaker"}),
    ):
        params = {**plain, **changed}
        named = {"texts": [params["text"]], **{k: v for k, v in params.items() if k not in ("text", "scene")}}
        named |= {"views": named.pop("view")} if "view" in named else {}
        answer = faces.rest.get("/query", params=params).json()
        assert answer == faces.rest.post(f"/v1/scenes/{scene_id}:query", json=named).json(), changed
        if "templates" not in changed and "coverage" not in changed:  # here the answer is the same with and without
            assert answer != faces.rest.get("/query", params=plain).json(), changed
    for name in ("version", "asker_view"):
        bad = {**question, name: "none"}
        assert rest_refusal(faces.rest.get("/query", params=bad)).details["field"] == name
