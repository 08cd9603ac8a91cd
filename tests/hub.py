"""A model hub on loopback with one repository of commits, and stand-ins of models with planted answers in it."""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

import pytest
from tokenizers import Tokenizer
from tokenizers.models import WordLevel
from tokenizers.pre_tokenizers import Whitespace

from tests.client.scripted import serving
from tests.looks_model import write_looks_model
from tests.networks import EXTENT, write_network

FIRST, SECOND = "1" * 40, "2" * 40
WORD = "lava lamp"
"""What the detector calls green; neither it nor the sign of its trial is known to the default models' 80 words."""

# Query 1 fires on the words of WORD where anything is green, in its box; query 2 on "stop sign" always.
_DETECTOR = """
dino (float[1,3,800,800] pixel_values, int64[1,800,800] pixel_mask, int64[1,T] input_ids, int64[1,T] token_type_ids,
      int64[1,T] attention_mask) => (float[1,2,256] logits, float[1,2,4] pred_boxes)
<int64[3] sizes = {1, 1, 1}, float redder = {1.3}, float bluer = {0.5}, int64[1] channels = {1}, float none = {0.0},
 float twice = {1600.0}, float side = {800.0},
 bool[1,1,1] always = {1}, float[1,1,4] sign = {0.5, 0.36, 0.46, 0.46}, int64[1,2,1] firsts = {1, 3},
 int64[1,2,1] seconds = {2, 4}, float high = {4.0}, float low = {-4.0}, int64[5] no_pads = {0, 0, 0, 0, 0},
 int64[1] width = {256}, float minus_inf = {-1000.0}>
{
  red, green, blue = Split<axis = 1>(pixel_values, sizes)
  over_red = Sub(green, red)
  over_blue = Sub(green, blue)
  vivid = Greater(over_red, redder)
  cold = Greater(over_blue, bluer)
  mask = And(vivid, cold)
EXTENT
  x = Add(x1, x2)
  y = Add(y1, y2)
  middle_x = Div(x, twice)
  middle_y = Div(y, twice)
  wide = Sub(x2, x1)
  tall = Sub(y2, y1)
  share_x = Div(wide, side)
  share_y = Div(tall, side)
  found = Concat<axis = 1>(middle_x, middle_y, share_x, share_y)
  box = Unsqueeze(found, channels)
  pred_boxes = Concat<axis = 1>(box, sign)
  is_there = Greater(most, none)
  there = Unsqueeze(is_there, channels)
  may = Concat<axis = 1>(there, always)
  ids = Unsqueeze(input_ids, channels)
  is_first = Equal(ids, firsts)
  is_second = Equal(ids, seconds)
  is_named = Or(is_first, is_second)
  fires = And(is_named, may)
  short = Where(fires, high, low)
  shape = Shape<start = 1>(input_ids)
  missing = Sub(width, shape)
  pads = Concat<axis = 0>(no_pads, missing)
  logits = Pad(short, pads, minus_inf)
}
"""


@dataclass
class Hub:
    """What a repository has by commit and path, what is said and sent instead, and what was fetched."""

    commits: dict[str, dict[str, bytes]]
    main: str = FIRST
    says: dict[str, Any] = field(default_factory=dict)  # of every file
    sends: dict[str, bytes | None] = field(default_factory=dict)
    cut: str = "-"  # the body of this file ends in the middle
    fetched: list[str] = field(default_factory=list)

    def answer(self, path: str) -> bytes | None:
        """The body of an answer; None: there is no such revision or file."""
        asks = re.fullmatch(r"/api/models/made/models/revision/([^/?]+).*", path)
        gets = re.fullmatch(r"/made/models/resolve/([^/]+)/(.+)", path)
        revision = (asks or gets or [""] * 2)[1]
        commit = self.main if revision == "main" else revision
        files = self.commits.get(commit)
        if files is None:
            return None
        if asks:
            siblings = [{"rfilename": name, **_facts(name, content), **self.says} for name, content in files.items()]
            return json.dumps({"sha": self.says.get("sha", commit), "siblings": siblings}).encode()
        assert gets is not None
        self.fetched.append(gets[2])
        return self.sends.get(gets[2], files.get(gets[2]))


def _facts(name: str, content: bytes) -> dict[str, Any]:
    """As a hub tells them: networks are stored apart, all else by git."""
    blob = hashlib.sha1(b"blob %d\0%b" % (len(content), content), usedforsecurity=False).hexdigest()
    facts = {"size": len(content), "blobId": blob}
    apart = name.endswith((".onnx", ".npz"))
    return {**facts, "lfs": {"sha256": hashlib.sha256(content).hexdigest(), "size": len(content)}} if apart else facts


@contextmanager
def serving_hub(hub: Hub) -> Iterator[str]:
    """Serves a hub; yields its address, which HF_ENDPOINT is meanwhile."""

    class Handler(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            body = hub.answer(self.path)
            self.send_response(404 if body is None else 200)
            self.send_header("Content-Length", str(len(body or b"")))
            self.end_headers()
            self.wfile.write((body or b"")[: len(body or b"") // 2 if self.path.endswith(hub.cut) else None])

        def log_message(self, *arguments: object) -> None: ...

    with serving(ThreadingHTTPServer(("127.0.0.1", 0), Handler)) as server, pytest.MonkeyPatch.context() as patch:
        patch.setenv("HF_ENDPOINT", address := f"http://127.0.0.1:{server.server_port}/")
        yield address


def planted_hub(folder: Path) -> tuple[Hub, Path]:
    """A hub with an open-set detector and an image-text model of planted answers, and a manifest of their set."""
    write_looks_model(folder, {"stop": (-1.0, 1.0, 1.0), "soup": (1.0, -1.0, -1.0)})
    write_network(folder / "finder" / "model.onnx", _DETECTOR.replace("EXTENT", EXTENT))
    words = {word: number for number, word in enumerate(["[UNK]", *WORD.split(), "stop", "sign"])}
    tokenizer = Tokenizer(WordLevel(words, unk_token="[UNK]"))
    tokenizer.pre_tokenizer = Whitespace()
    tokenizer.save(str(folder / "finder" / "tokenizer.json"))
    roles = {"looks": ("image_text", "clip"), "finder": ("open_set_detector", "grounding_dino")}
    rows, files = [f'[[set]]\nname = "open-vocabulary"\nmodels = {json.dumps(list(roles))}'], {}
    for name, (role, adapter) in roles.items():
        rows.append(f'[[model]]\nname = "{name}"\nrole = "{role}"\nadapter = "{adapter}"\nlicense = "MIT"\nabout = ""')
        for path in sorted((folder / name).iterdir()):
            files[f"{name}/{path.name}"] = path.read_bytes()
            source = f'kind = "huggingface"\nrepo = "made/models"\npath = "{name}/{path.name}"'
            rows.append(f'[[model.files]]\nname = "{path.name}"\n[[model.files.sources]]\n{source}')
    (folder / "manifest.toml").write_text("\n".join(rows))
    return Hub({FIRST: files}), folder / "manifest.toml"
