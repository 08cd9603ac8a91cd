"""A small scene made by hand and put into a store as a finished job would leave it."""

from __future__ import annotations

import dataclasses
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
from PIL import Image

from fastsplat.service.application.service import SceneService
from fastsplat.service.common.dictionary import Dictionary, DictionaryEntry
from fastsplat.service.perception.results import TextEncoder
from fastsplat.service.perception.text.text_encoders import open_text_encoder
from fastsplat.service.query.query_settings import QuerySettings
from fastsplat.service.scene.artefact.scene import SH_C0, Object, ObjectGroup, Objects, Parts, Scene
from fastsplat.service.scene.objects.label_evidence import UNIT, evidence_of
from fastsplat.service.settings import Settings
from fastsplat.service.store.repositories.name_repository import NewName, VersionNames, record_names
from fastsplat.service.store.rows.database import transaction
from fastsplat_contract.geometry.camera import Camera, PosedCamera
from fastsplat_contract.photos.observations import Observation
from tests.capture.upload_files import encoded
from tests.scenes import add_photos, labelled_scene, stand_in_models, store_scene

ENCODER = "label_table:words"
LABELS = ("mug", "ball", "story book")
KINDRED = {"mug": ("cup", "beaker"), "ball": ("sphere", "balloon"), "story book": ("novel", "paperback")}
STRANGERS = ("elephant", "submarine", "volcano", "violin", "carrot", "moon")
PHRASES = tuple(
    "object left of the ball/mug left of the ball/second object from the right/second object/red mug/blue mug/objects/"
    "object/left/mug on the piano/piano/how many objects are red/"
    "how many submarines are/submarines".split("/")
)
"""Questions that say more than a name, as they are embedded, and what they are made of."""
PHOTO_COLORS = ((200, 10, 10), (10, 200, 10), (10, 10, 200))  # of its three cameras' photos, each of one color
PLAIN_PNG = encoded(np.full((24, 32, 3), (120, 130, 140), np.uint8))  # an image file in which nothing is to be seen
_PER_BLOB = 60
OBSERVED = "e0123456789abcdef"  # the observation of the made scene: all three objects were looked at, none has changed
_OBSERVATION = Observation(
    "", OBSERVED, datetime(2026, 3, 2, 18, tzinfo=UTC), "given", (), (), (), (1, 2, 3), True, "Nothing has changed."
)
_CAMERA = Camera(width=48, height=36, fx=45.0, fy=45.0, cx=24.0, cy=18.0)


def write_words(models: Path, *more: str) -> None:
    """A text encoder: kindred words close together, strangers (and `more` of them) far from all; stand-ins beside."""
    rng = np.random.default_rng(7)
    vectors: dict[str, np.ndarray] = {}
    for word in (*LABELS, *STRANGERS, *QuerySettings().negatives, *more, *PHRASES):
        vectors[word] = rng.normal(size=64)
        for kin in KINDRED.get(word, ()):
            vectors[kin] = vectors[word] + 0.4 * rng.normal(size=64)
    templates = QuerySettings().templates
    names = [template.format(word) for word in vectors for template in templates]
    embeds = np.repeat(np.array(list(vectors.values())), len(templates), axis=0).astype(np.float32)
    (stand_in_models(models) / "words").mkdir()
    np.savez(models / "words" / "words.npz", names=np.array(names), embeds=embeds)


def made_scene(encoder: TextEncoder) -> Scene:
    """Three coloured blobs side by side and a grey floor, seen by three cameras; meters."""
    rng = np.random.default_rng(3)
    centres = np.array([[-0.8, 0, 4], [0, 0, 4], [0.8, 0, 4], [0, 0.8, 4]], dtype=np.float32)
    colours = np.array([[0.9, 0.1, 0.1], [0.1, 0.8, 0.1], [0.1, 0.2, 0.9], [0.5, 0.5, 0.5]], dtype=np.float32)
    blob = np.repeat(np.arange(4), _PER_BLOB)
    spread = np.where(blob[:, None] == 3, [0.8, 0.05, 0.5], 0.12)
    count = len(blob)
    dictionary = Dictionary(tuple(DictionaryEntry(label, pixels=100, views=3) for label in LABELS))
    return labelled_scene(
        centres[blob] + spread * rng.normal(size=(count, 3)),
        np.where(blob < 3, blob + 1, 0),
        dictionary,
        quats=rng.normal(size=(count, 4)),
        scales=rng.uniform(0.05, 0.12, size=(count, 3)),
        logit_opacities=rng.uniform(1.0, 3.0, size=count),
        sh=((colours[blob] - 0.5) / SH_C0)[:, None, :],
        undetected_bias=2.0,
        encoder=encoder,
        templates=QuerySettings().templates,
        cameras=[
            dataclasses.replace(turned(angle), name=name)
            for angle, name in ((0.0, "front.png"), (0.3, "photos/left side & ü.png"), (-0.3, "a/b/right.png"))
        ],
        observations=(_OBSERVATION,),
        quality={"psnr": 31.5, "images": 3, "registered": 3, "stage_seconds": {"training": 12.5}},
    )


def parted_scene(encoder: TextEncoder) -> Scene:
    """The made scene with stored objects 1 to 3, of which the left half of the mug is part 4; 1 and 2 are group 7."""
    scene = made_scene(encoder)
    rows = np.arange(len(scene.gaussians))
    owner = np.repeat([1, 2, 3, 0], _PER_BLOB)
    left = np.flatnonzero((owner == 1) & (scene.gaussians.means[:, 0] < -0.8))
    half = evidence_of(left, np.full(len(left), 4), np.full(len(left), UNIT), len(rows))
    table = tuple(Object(number, name, "detected", 0.9) for number, name in enumerate(LABELS, 1))
    membership = evidence_of(rows, owner, np.full(len(rows), 16 * UNIT), len(rows))
    parts = Parts((Object(4, parent=1, consensus=0.5),), half)
    return dataclasses.replace(
        scene, objects=Objects(table, membership, 0, parts, groups=(ObjectGroup(7, (1, 2), 0.5),))
    )


def turned(angle: float) -> PosedCamera:
    """A free viewpoint 4 m from the blobs' middle, `angle` radians around the vertical axis, looking at it."""
    pose = np.eye(4)
    pose[:3, :3] = [[np.cos(angle), 0, np.sin(angle)], [0, 1, 0], [-np.sin(angle), 0, np.cos(angle)]]
    pose[:3, 3] = np.array([0, 0, 4.0]) - pose[:3, :3] @ np.array([0, 0, 4.0])
    return PosedCamera(_CAMERA, pose)


def add_scene(service: SceneService, settings: Settings, name: str = "made") -> str:
    """Store the scene as a job that succeeded; returns its id."""
    encoder = open_text_encoder(ENCODER, settings.models)
    stage = {"stage": "training", "fraction": 1.0, "message": "done", "seconds": 12.5, "metrics": {"psnr": 31.5}}
    scene_id = store_scene(service._store, made_scene(encoder), name, stages=[stage])
    add_photos(service._store, scene_id, [Image.new("RGB", (24, 18), color) for color in PHOTO_COLORS])
    return scene_id


def add_known_name(service: SceneService, scene_id: str, name: str = "mug") -> str:
    """Store a name as if a person had given it to object 1 in the current version of a scene; returns its id."""
    store = service._store
    version = store.scenes.scene(scene_id).version
    names = VersionNames([NewName(1, name, b"\0\0", b"\xff\xd8\xff")], limit=1000)
    with transaction(store.engine) as connection:
        record_names(connection, scene_id, "", version, names)
    return f"{scene_id}-1"
