"""Access keys of a project: what its admins make, see and take back."""

from __future__ import annotations

from dataclasses import dataclass, field
from datetime import datetime
from typing import Annotated, ClassVar, Literal, NamedTuple

from pydantic import Field

from fastsplat_contract.codec.wire import Many, Request, Response, travels

Role = Literal["uploader", "suggester", "reader", "editor", "admin", "operator"]
KeyState = Literal["VALID", "EXPIRED", "REVOKED"]

MAX_LIFETIME_S = 3.2e9
UPLOAD_KEY_S, MAX_UPLOAD_KEY_S = 900.0, 3_600.0


@dataclass(frozen=True)
class KeyIn(Request):
    """A new key of the caller's project."""

    proto: ClassVar[str] = "CreateKeyRequest"

    name: Annotated[str, Field(description="whose key it is, for people")]
    role: Annotated[
        Role,
        Field(
            description="uploader: post one scene and watch its job; suggester: see objects without a name and suggest "
            "names; reader: query and view; editor: also create and change; admin: also delete, and keys of the "
            "project; operator: all that in any project. At most the caller's own"
        ),
    ] = "editor"
    lifetime_s: Annotated[
        float | None, Field(gt=0, le=MAX_LIFETIME_S, description="seconds until it expires; absent: never")
    ] = None
    scene_id: Annotated[
        str,
        Field(description="the one scene that it shows, e.g. for a link; then a reader's, and it expires; empty: all"),
    ] = ""


@dataclass(frozen=True)
class UploadKeyIn(Request):
    """A new key for one upload: its bearer may post one scene, watch its job, and do nothing else."""

    proto: ClassVar[str] = "CreateUploadKeyRequest"

    lifetime_s: Annotated[
        float | None,
        Field(
            gt=0,
            le=MAX_UPLOAD_KEY_S,
            description="seconds until it expires, if no upload has begun with it by then; one that has may go on for "
            "a day; absent: 15 minutes",
        ),
    ] = None


@dataclass(frozen=True)
class AccessKey(Response):
    """What is known of a key; the key itself is not stored."""

    id: Annotated[str, Field(description="part of the key, and of log lines")]
    name: Annotated[str, Field(description="for people")]
    project: Annotated[str, Field(description="whose scenes it sees")]
    role: Role
    state: KeyState
    created_at: datetime
    expires_at: Annotated[datetime | None, Field(description="absent: never")]
    revoked_at: Annotated[datetime | None, Field(description="absent unless it was revoked")]
    scene_id: Annotated[str, Field(description="the one scene that it shows; empty: all of the project")] = ""
    operation_id: Annotated[str, Field(description="of a key for one upload: the operation that it made, if any")] = ""


@dataclass(frozen=True)
class NewKey(Response):
    """A key that was just made; nobody can tell it again."""

    key: AccessKey
    secret: Annotated[str, Field(description="the key itself, as callers send it; it is not shown again")] = field(
        repr=False
    )


@travels(request=False, proto="ListKeysResponse")
class KeyList(NamedTuple):
    """One page of a project's keys (AIP-158), newest first; revoked and expired ones, too."""

    keys: Many[AccessKey]
    next_page_token: Annotated[str, Field(description="empty on the last page")]
