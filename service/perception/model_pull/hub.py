"""Model hubs: the commit, sizes and digests of files, known before any is fetched.

`HF_ENDPOINT` names another hub than Hugging Face. Functions raise `RefusedError`.
"""

from __future__ import annotations

import os
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any
from urllib.parse import quote

from pydantic import ValidationError

from fastsplat.service.perception.models.model_files import Receipt
from fastsplat.service.perception.models.model_manifest import HubSource, ModelEntry, ModelFile

Bytes = Callable[[int, int], None]
"""Called with the bytes that have arrived and their total (0: unknown)."""

_HUB = "https://huggingface.co"
_MAIN = "main"
_SILENCE_S = 60


class RefusedError(Exception):
    """The source does not have the file, or has another one."""


def pinned(entry: ModelEntry, receipt: Receipt, revision: str | None) -> ModelEntry:
    """Fills in the commit, sizes and digests of files of hubs.

    A commit of the manifest counts first, then `revision` (commit, branch or tag), then the one of the receipt, whose
    digests then hold too, then the newest of "main".
    """
    listings: dict[tuple[str, str], tuple[str, dict[str, Any]]] = {}
    files = []
    for file in entry.files:
        source = file.sources[0] if file.sources else None
        if not isinstance(source, HubSource):
            files.append(file)
            continue
        trusted = receipt.hub.get(file.name, {})
        known = trusted.get("commit") if trusted.get("repo") == source.repo else None
        wanted = source.revision or revision or known or _MAIN
        if (source.repo, wanted) not in listings:
            listings[source.repo, wanted] = _listing(source.repo, wanted)
        commit, listed = listings[source.repo, wanted]
        if re.fullmatch(r"[0-9a-f]{40}", wanted) and commit != wanted:
            raise RefusedError(f"{source.repo} has {commit} for the commit {wanted}")
        sha256 = receipt.sha256.get(file.name) if commit == known else None
        files.append(_pinned_file(file, source, commit, listed, sha256))
    return entry.model_copy(update={"files": tuple(files)})


def _pinned_file(
    file: ModelFile, source: HubSource, commit: str, listed: dict[str, Any], trusted: str | None
) -> ModelFile:
    found = listed.get(source.path)
    if found is None:
        raise RefusedError(f"{source.repo} at {commit} has no {source.path}")
    stored = found.get("lfs") or {}  # git itself stores small files, by another digest
    given = {"size": found.get("size"), "sha256": stored.get("sha256"), "git_blob": found.get("blobId")}
    given["git_blob"] = None if stored else given["git_blob"]
    for key, value in (("size", file.size), ("sha256", file.sha256 or trusted)):
        if value is not None and given[key] not in (None, value):
            raise RefusedError(f"{source.repo}/{source.path} at {commit} has the {key} {given[key]}, expected {value}")
        given[key] = value or given[key]
    if given["size"] is None or not (given["sha256"] or given["git_blob"]):
        raise RefusedError(f"{source.repo} says no size and digest of {source.path}")
    sources = [{**source.model_dump(), "revision": commit}]
    try:
        return ModelFile.model_validate({**file.model_dump(), **given, "sources": sources})
    except ValidationError as error:
        raise RefusedError(f"{source.repo} describes {source.path} wrongly") from error


def _listing(repo: str, revision: str) -> tuple[str, dict[str, Any]]:
    """Returns the commit that a revision is, and the hub's facts of its files by path."""
    import httpx

    address = f"{_endpoint()}/api/models/{repo}/revision/{quote(revision, safe='')}"
    try:
        answer = httpx.get(address, params={"blobs": "true"}, timeout=_SILENCE_S, follow_redirects=True)
        answer.raise_for_status()
        found = answer.json()
        return str(found["sha"]), {str(file["rfilename"]): file for file in found["siblings"]}
    except (httpx.HTTPError, httpx.InvalidURL, ValueError, LookupError, TypeError) as error:
        raise RefusedError(f"{address}: {error!r}"[:300]) from error


def fetch_hub_file(source: HubSource, target: Path, on_bytes: Bytes) -> None:
    """Writes a file of a pinned source to `target`."""
    download(f"{_endpoint()}/{source.repo}/resolve/{source.revision}/{source.path}", target, on_bytes)


def download(address: str, target: Path, on_bytes: Bytes) -> None:
    """Writes what is at an address to `target`."""
    import httpx

    try:
        with (
            httpx.stream("GET", address, timeout=_SILENCE_S, follow_redirects=True) as answer,
            target.open("wb") as out,
        ):
            answer.raise_for_status()
            total = int(answer.headers.get("content-length", 0))
            for chunk in answer.iter_bytes():
                out.write(chunk)
                on_bytes(out.tell(), total)
    except (httpx.HTTPError, httpx.InvalidURL, OSError) as error:
        raise RefusedError(f"{address}: {error}") from error


def _endpoint() -> str:
    return (os.environ.get("HF_ENDPOINT") or _HUB).rstrip("/")
