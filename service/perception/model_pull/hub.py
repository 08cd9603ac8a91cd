"""Model hubs: the commit, sizes and digests of files, known before any is fetched.

`HF_ENDPOINT` names another hub than Hugging Face. Functions raise `RefusedError`.
"""

from __future__ import annotations

import os
import re
from collections.abc import Callable
from functools import cache
from pathlib import Path
from urllib.parse import quote

from pydantic import BaseModel

from fastsplat.service.perception.models.model_files import Receipt
from fastsplat.service.perception.models.model_manifest import Commit, HubSource, ModelEntry, ModelFile, Sha256

Bytes = Callable[[int, int], None]
"""Called with the bytes that have arrived and their total (0: unknown)."""

_HUB = "https://huggingface.co"
_SILENCE_S = 60


class RefusedError(Exception):
    """The source does not have the file, or has another one."""


class _StoredApart(BaseModel):
    sha256: Sha256


class _Listed(BaseModel):
    rfilename: str
    size: int
    lfs: _StoredApart | None = None  # absent for small files, which git itself stores
    blobId: Commit | None = None  # noqa: N815 - the hub's name


class _Listing(BaseModel):
    """A commit, and the hub's facts of its files."""

    sha: Commit
    siblings: tuple[_Listed, ...]


def pinned(entry: ModelEntry, receipt: Receipt, revision: str | None) -> ModelEntry:
    """Fills in the commit, sizes and digests of files of hubs.

    A commit of the manifest counts first, then `revision` (commit, branch or tag), then the one of the receipt, whose
    digests then hold too, then the newest of "main".
    """
    listing = cache(_listing)  # a request a repository
    files = []
    for file in entry.files:
        source = file.sources[0] if file.sources else None
        if isinstance(source, HubSource):
            trusted = receipt.hub.get(file.name, {})
            known = trusted.get("commit") if trusted.get("repo") == source.repo else None
            listed = listing(source.repo, source.revision or revision or known or "main")
            sha256 = receipt.sha256.get(file.name) if listed.sha == known else None
            file = _pinned_file(file, source, listed, file.sha256 or sha256)
        files.append(file)
    return entry.model_copy(update={"files": tuple(files)})


def _pinned_file(file: ModelFile, source: HubSource, listed: _Listing, expected: str | None) -> ModelFile:
    where = f"{source.repo} at {listed.sha}"
    found = next((found for found in listed.siblings if found.rfilename == source.path), None)
    if found is None:
        raise RefusedError(f"{where} has no {source.path}")
    sha256, blob = (found.lfs.sha256, None) if found.lfs else (None, found.blobId)
    for what, given, wanted in (("size", found.size, file.size), ("sha256", sha256, expected)):
        if None not in (given, wanted) and given != wanted:
            raise RefusedError(f"{source.path} of {where} has the {what} {given}, expected {wanted}")
    if not (sha256 or blob):
        raise RefusedError(f"{where} says no digest of {source.path}")
    sources = (source.model_copy(update={"revision": listed.sha}),)
    facts = {"size": found.size, "sha256": sha256 or expected, "git_blob": blob, "sources": sources}
    return file.model_copy(update=facts)


def _listing(repo: str, revision: str) -> _Listing:
    import httpx

    address = f"{_endpoint()}/api/models/{repo}/revision/{quote(revision, safe='')}"
    try:
        answer = httpx.get(address, params={"blobs": "true"}, timeout=_SILENCE_S, follow_redirects=True)
        answer.raise_for_status()
        listed = _Listing.model_validate_json(answer.content)
    except (httpx.HTTPError, httpx.InvalidURL, ValueError) as error:
        raise RefusedError(f"{address}: {_reason(error)}"[:400]) from error
    if re.fullmatch(r"[0-9a-f]{40}", revision) and listed.sha != revision:
        raise RefusedError(f"{repo} has {listed.sha} for the commit {revision}")
    return listed


def fetch_hub_file(source: HubSource, target: Path, on_bytes: Bytes) -> None:
    """Writes a file of a pinned source to `target`."""
    download(f"{_endpoint()}/{source.repo}/resolve/{source.revision}/{source.path}", target, on_bytes)


def download(address: str, target: Path, on_bytes: Bytes) -> None:
    """Writes what is at an address to `target`."""
    import httpx

    try:
        with httpx.stream("GET", address, timeout=_SILENCE_S, follow_redirects=True) as reply, target.open("wb") as out:
            reply.raise_for_status()
            total = int(reply.headers.get("content-length", 0))
            for chunk in reply.iter_bytes():
                out.write(chunk)
                on_bytes(out.tell(), total)
    except (httpx.HTTPError, httpx.InvalidURL, OSError) as error:
        raise RefusedError(f"{address}: {_reason(error)}") from error


def _reason(error: Exception) -> str:
    """Says why a request failed, in one line: the status of its answer, else the error."""
    answer = getattr(error, "response", None)
    status = f"{answer.status_code} {answer.reason_phrase}" if answer else ""
    return status or " ".join(str(error).split()) or type(error).__name__


def _endpoint() -> str:
    return (os.environ.get("HF_ENDPOINT") or _HUB).rstrip("/")
