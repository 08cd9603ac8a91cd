"""Text encoders: unit vectors whose angles mean something, each text once, in order, at the priority of who asks."""

from __future__ import annotations

import hashlib
import json
import os
import shutil
import sys
import threading
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest

from fastsplat.service.common.process import lower_priority
from fastsplat.service.perception.models.model_files import only_network
from fastsplat.service.perception.text.text_encoders import ClipTextEncoder, embed_side_by_side, open_text_encoder
from fastsplat_contract.errors import InvalidInputError, ModelUnavailableError


def test_minilm_rows_are_unit_and_independent_of_neighbours(models_dir: Path) -> None:
    encoder = open_text_encoder("minilm_l6_int8", models_dir, threads=2)
    texts = ["cup", "the coffee machine that stands beside the window of the kitchen", "BED"]
    together = encoder.encode(texts)
    assert together.dtype == np.float32
    np.testing.assert_allclose(np.linalg.norm(together, axis=1), 1, atol=1e-5)
    for text, row in zip(texts, together, strict=True):
        np.testing.assert_array_equal(encoder.encode([text])[0], row)
    assert encoder.name == "minilm_l6_int8"
    assert len(encoder.sha256) == 64


def test_minilm_cuts_long_texts(models_dir: Path) -> None:
    encoder = open_text_encoder("minilm_l6_int8", models_dir, threads=2)
    long, longer = encoder.encode(["cup " * 254, "cup " * 5000])
    np.testing.assert_allclose(long, longer, atol=1e-5)


def test_a_damaged_tokenizer_is_refused(clip_file: Path, tmp_path: Path) -> None:
    (tmp_path / "broken.json").write_text("{")
    for name in ("broken.json", "missing.json"):
        with pytest.raises(ModelUnavailableError, match=name):
            ClipTextEncoder(clip_file, tmp_path / name, name="tower")


def test_label_table_knows_its_labels_only(tmp_path: Path) -> None:
    (tmp_path / "words").mkdir()
    np.savez(
        tmp_path / "words" / "table.npz",
        names=np.array(["coffee cup", "Coffee Cups", "lamp"]),
        embeds=np.array([[3, 0], [0, 5], [4, 3]], np.float16),
    )
    encoder = open_text_encoder("label_table:words", tmp_path)
    np.testing.assert_allclose(encoder.encode(["COFFEE_CUPS", "lamp"]), [[1, 0], [0.8, 0.6]], atol=1e-6)
    with pytest.raises(InvalidInputError, match="sofa, tree"):
        encoder.encode(["sofa", "lamp", "tree"])


@pytest.mark.parametrize("file", ["model.onnx", "tokenizer.json"])
def test_a_model_with_a_flipped_bit_is_refused_by_name(file: str, models_dir: Path, tmp_path: Path) -> None:
    folder = tmp_path / "minilm_l6_int8"
    shutil.copytree(models_dir / "minilm_l6_int8", folder, copy_function=shutil.copyfile)
    assert open_text_encoder("minilm_l6_int8", tmp_path).encode(["mug"]).shape[0] == 1
    content = bytearray((folder / file).read_bytes())
    content[len(content) // 2] ^= 1
    models = tmp_path / "flipped"
    (models / "minilm_l6_int8").mkdir(parents=True)
    for path in folder.iterdir():
        (models / "minilm_l6_int8" / path.name).write_bytes(content if path.name == file else path.read_bytes())
    with pytest.raises(ModelUnavailableError, match=f"{file} is damaged"):
        open_text_encoder("minilm_l6_int8", models)


def test_what_a_pull_converted_is_checked_against_its_receipt(tmp_path: Path) -> None:
    digests = {"a.onnx": hashlib.sha256(b"network").hexdigest()}
    (tmp_path / "pulled.json").write_text(json.dumps({"sha256": digests}))
    (tmp_path / "a.onnx").write_bytes(b"network")
    assert only_network(tmp_path, name="sentence:mine") == tmp_path / "a.onnx"
    folder = tmp_path / "other"
    shutil.copytree(tmp_path, folder, ignore=shutil.ignore_patterns("other"))
    (folder / "a.onnx").write_bytes(b"netwosk")
    with pytest.raises(ModelUnavailableError, match=r"a\.onnx is damaged"):
        only_network(folder, name="sentence:mine")
    (folder / "pulled.json").write_text('{"sha256": ')
    with pytest.raises(ModelUnavailableError, match=r"pulled\.json is damaged"):
        only_network(folder, name="sentence:mine")


@pytest.mark.parametrize("threads", [0, 1, 2, 7])
@pytest.mark.parametrize("count", [1, 2, 9])
def test_rows_are_in_the_order_of_the_texts_and_each_runs_once(threads: int, count: int) -> None:
    ran: list[str] = []

    def run(text: str) -> np.ndarray:
        ran.append(text)
        return np.array([float(text), 1.0], np.float32)

    texts = [str(number) for number in range(count)]
    rows = embed_side_by_side(run, texts, threads)
    assert rows.dtype == np.float32 and rows[:, 0].tolist() == list(range(count))
    assert sorted(ran) == texts


def test_as_many_run_at_a_time_as_there_are_threads() -> None:
    together = threading.Barrier(3)  # which opens only if three runs wait at once
    embed_side_by_side(lambda text: np.full(1, together.wait(30), np.float32), ["a", "b", "c"], 3)


@pytest.mark.skipif(sys.platform != "linux", reason="threads have a niceness of their own on Linux alone")
def test_runs_have_the_priority_of_the_thread_that_asks() -> None:
    def priority() -> int:
        return os.getpriority(os.PRIO_PROCESS, threading.get_native_id())

    def nicely() -> tuple[int, set[float]]:
        lower_priority(3)
        rows = embed_side_by_side(lambda text: np.full(1, priority(), np.float32), ["a", "b", "c", "d"], 2)
        return priority(), set(rows[:, 0].tolist())

    with ThreadPoolExecutor(1) as pool:
        niceness, of_runs = pool.submit(nicely).result()
    assert niceness > priority() and of_runs == {niceness}
