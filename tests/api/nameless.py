"""The sample after its names were taken away, behind a server."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import NamedTuple

import numpy as np

from fastsplat.service.application.service import open_service
from fastsplat.service.settings import CaptionerSettings
from fastsplat_contract.messages.scenes import Edit
from tests.api.clients import client_of
from tests.api.served import Faces, on_free_ports, served


class Nameless(NamedTuple):
    """The server, the scene, and what its objects were called, by their ids."""

    faces: Faces
    scene_id: str
    truth: Mapping[int, str]


@contextmanager
def nameless_sample(models_dir: Path, folder: Path, captioner: CaptionerSettings | None = None) -> Iterator[Nameless]:
    """Serve it, without keys, until the block ends; with a captioner of the server's own, if one is given."""
    settings = on_free_ports(data_dir=folder, models=models_dir, captioner=captioner or CaptionerSettings())
    with open_service(settings) as service, served(service, settings) as faces:
        scene_id = service.open_sample().id
        with client_of(faces) as client:
            truth = {obj.id: obj.name for obj in client.objects(scene_id) if obj.name}
            client.edit_scene(scene_id, [Edit("unname", object_ids=tuple(truth))])
        yield Nameless(faces, scene_id, truth)


def seen_with_errors(truth: Mapping[int, str], seed: int) -> dict[int, str]:
    """What a stand-in sees: the truth, but for one object in ten."""
    wrong = np.random.default_rng(seed).choice(list(truth), -(-len(truth) // 10), replace=False).tolist()
    return {obj: "umbrella" if obj in wrong else name for obj, name in truth.items()}
