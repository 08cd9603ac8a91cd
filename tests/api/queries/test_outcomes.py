"""Five outcomes, each in one sentence: REST, gRPC, assistants and the command line print the same one."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from fastsplat.service.application.service import SceneService
from fastsplat.service.common.dictionary import dictionary_of
from fastsplat.service.query.objects.labeled_objects import label_gaussians, labeled_objects
from fastsplat.service.query.objects.unseen_space import surface_kind
from fastsplat.service.scene.artefact.scene import SceneFacts, SemanticHead
from fastsplat.service.scene.artefact.suggestions import Suggestion
from fastsplat_client import Client
from fastsplat_client.assistant.tools import find
from fastsplat_contract.messages.queries import Outcome, QueryRequest
from tests.api.made_scene import ENCODER
from tests.api.served import Faces
from tests.commands import invoke
from tests.query.box_scenes import scene_of
from tests.query.walled_room import OBJECTS, SCREEN, WALLS, from_corner
from tests.scenes import store_scene


@pytest.fixture(scope="module")
def screened(service: SceneService) -> str:
    """A room with a screen that hides a part of it; a lamp has no name of its own, and may be a violin."""
    scene = scene_of([*WALLS, *OBJECTS, SCREEN], from_corner())
    objects = labeled_objects(scene, label_gaussians(scene))
    names = {"mug": "mug", "book": "ball", "screen": "story book"}
    table = tuple(
        replace(
            obj,
            name=names.get(obj.name, ""),
            source="person" if obj.name in names else None,
            probability=float(obj.name in names),
            surface=surface_kind(obj.name),
            suggestions=(Suggestion("violin", 0.3),) if obj.name == "lamp" else (),
        )
        for obj in objects.table
    )
    dictionary = dictionary_of([*names.values()])
    return store_scene(
        service._store,
        replace(
            scene,
            objects=replace(objects, table=table, head=None),
            dictionary=dictionary,
            head=SemanticHead.unlearnt(len(dictionary), scene.gaussians.codes.shape[1]),
            label_embeddings=np.zeros((len(dictionary), 16), np.float32),
            text_encoder=(ENCODER, "0" * 64),
            facts=SceneFacts(searched_for=("elephant",)),
        ),
    )


@pytest.mark.parametrize(
    ("text", "outcome", "said"),
    [
        ("mug", "here", 'Here: "mug".'),
        ("violin", "probably_here", 'Perhaps here (30 %): an unnamed object may be "violin".'),
        ("elephant", "not_seen", "Not seen: none of the "),
        ("mug left of the ball", "cannot_say", "Cannot say: "),
        ("elephant", "not_here", "Not here"),
    ],
)
def test_each_outcome_has_one_sentence_everywhere(
    faces: Faces, client: Client, screened: str, scene_id: str, text: str, outcome: Outcome, said: str
) -> None:
    scene = scene_id if outcome == "not_here" else screened
    (answer,) = client.query(scene, text)
    assert answer.outcome == outcome
    assert answer.sentence.startswith(said)
    (over_rpc,) = client.ask(QueryRequest(scene, (text,)), protocol="gRPC")
    (of_all,) = (answer for answer in client.query("", text) if answer.scene_id == scene)
    found = find(client, text, scene)
    assert over_rpc.sentence == of_all.sentence == found.sentence == answer.sentence
    assert over_rpc.outcome == of_all.outcome == found.outcome == outcome
    url = str(faces.rest.base_url)
    printed = invoke("ask", scene, text, "--server", url)
    assert printed.stdout.splitlines()[0] == answer.sentence
