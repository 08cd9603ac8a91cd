"""A stand-in captioner in the OpenAI chat format that says of each known sheet's objects what is planned."""

from __future__ import annotations

import base64
import json
from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager
from typing import Any

from fastsplat_contract.messages.contact_sheets import ContactSheet
from tests.client.scripted import Scripted, serving

Says = Callable[[ContactSheet], Any]
"""What is said of a sheet: JSON, or the bytes of a whole response with its status."""


class ReplayCaptioner(Scripted):
    """Answers `chat/completions` with what `says` says of the sheet whose picture came, and remembers what it got."""

    def __init__(self, sheets: Sequence[ContactSheet], says: Says) -> None:
        super().__init__()
        self.sheets = {sheet.picture: sheet for sheet in sheets}
        self.says = says
        self.url += "/v1"

    @property
    def got(self) -> list[tuple[str, Mapping[str, str], Any]]:
        """Path, headers and message of each request."""
        return [(line.removeprefix("POST "), headers, json.loads(body)) for line, headers, body in self.seen]

    def answer_to(self, body: bytes) -> Any:
        text, picture = json.loads(body)["messages"][1]["content"]
        head, _, data = picture["image_url"]["url"].partition(",")
        assert head == "data:image/jpeg;base64" and text["type"] == "text"
        said = self.says(self.sheets[base64.b64decode(data)])
        if isinstance(said, tuple):
            return said
        message = {"role": "assistant", "content": json.dumps(said)}
        return 200, {}, json.dumps({"choices": [{"message": message}]}).encode()


def replayed(sheets: Sequence[ContactSheet], says: Says) -> AbstractContextManager[ReplayCaptioner]:
    """Serve it on this machine until the block ends."""
    return serving(ReplayCaptioner(sheets, says))


def named(sheet: ContactSheet, names: Mapping[int, str], probability: float = 0.9) -> dict[str, Any]:
    """An answer as it is asked for, with the names of objects by their ids."""
    entries = [
        {"number": obj.number, "name": names[obj.object_id], "probability": probability, "aliases": []}
        for obj in sheet.objects
        if obj.object_id in names
    ]
    return {"names": entries}
