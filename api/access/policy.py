"""The access policy: role and cost of each call, looked up by the matched route, never by the text of a path.

A row is a call of the contract: its RPC, and the REST routes that do the same. What no row names needs an operator, so
that nothing is open by mistake.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

from fastsplat.service.store.key_repository import ROLES
from fastsplat_contract.keys import Role
from fastsplat_contract.v1 import fastsplat_pb2


class Rule(NamedTuple):
    """A row of the policy: what one call needs.

    Attributes:
        role: the least one that will do; None: no key is needed.
        long_lived: it waits or streams for long: it counts among its key's calls, not among those that compute.
        upload: it brings files, for as long as its sender takes.
        shared: a key of one scene may make it; that scene is then all that there is.
        one_upload: a key for one upload will do, too; it does nothing else.
    """

    role: Role | None
    long_lived: bool = False
    upload: bool = False
    shared: bool = False
    one_upload: bool = False

    def allows(self, role: Role) -> bool:
        """Whether a caller of this role may make the call."""
        if role == "uploader":
            return self.role is None or self.one_upload
        return self.role is None or ROLES.index(role) >= ROLES.index(self.role)


_OPEN = Rule(None)
_READ = Rule("reader")
_SHOW = Rule("reader", shared=True)
_FETCH = Rule("reader", long_lived=True, shared=True)
_EDIT = Rule("editor")
_ADMIN = Rule("admin")
_OPERATE = Rule("operator")
_WATCH = Rule("reader", long_lived=True)
_UPLOAD = Rule("editor", long_lived=True, upload=True, one_upload=True)
_MANAGE_UPLOAD = Rule("editor", one_upload=True)
_FOLLOW = Rule("reader", one_upload=True)
_FOLLOW_LONG = Rule("reader", long_lived=True, one_upload=True)

UNMATCHED = Rule("reader", long_lived=True)
"""A path that no route has, or not with this method: with any key one learns that there is none."""

_CALLS: Mapping[str, tuple[Rule, tuple[str, ...]]] = {
    "CreateScene": (_UPLOAD, ("POST /v1/scenes",)),
    "GetScene": (_SHOW, ("GET /v1/scenes/{scene_id}",)),
    "ListScenes": (_SHOW, ("GET /v1/scenes",)),
    "UpdateScene": (_EDIT, ("PATCH /v1/scenes/{scene_id}",)),
    "DeleteScene": (_ADMIN, ("DELETE /v1/scenes/{scene_id}",)),
    "MeasureScene": (_SHOW, ("POST /v1/scenes/{scene_id}:measure",)),
    "ListLabels": (_SHOW, ("GET /v1/scenes/{scene_id}/labels",)),
    "ListObjects": (_SHOW, ("GET /v1/scenes/{scene_id}/objects",)),
    "ListThings": (_SHOW, ("GET /v1/scenes/{scene_id}/things",)),
    "PickThing": (_SHOW, ("POST /v1/scenes/{scene_id}:pick",)),
    "ListVersions": (_SHOW, ("GET /v1/scenes/{scene_id}/versions",)),
    "ListPhotoVerdicts": (_READ, ("GET /v1/scenes/{scene_id}/photo-verdicts",)),
    "EditScene": (_EDIT, ("POST /v1/scenes/{scene_id}:edit",)),
    "LookAgain": (_EDIT, ("POST /v1/scenes/{scene_id}:lookAgain",)),
    "TrainMore": (_EDIT, ("POST /v1/scenes/{scene_id}:trainMore",)),
    "AlignScene": (_EDIT, ("POST /v1/scenes/{scene_id}:align",)),
    "UndoEdit": (_EDIT, ("POST /v1/scenes/{scene_id}:undo",)),
    "RedoEdit": (_EDIT, ("POST /v1/scenes/{scene_id}:redo",)),
    "RestoreVersion": (_EDIT, ("POST /v1/scenes/{scene_id}:restore",)),
    "ListOperations": (_READ, ("GET /v1/operations",)),
    "GetOperation": (_FOLLOW, ("GET /v1/operations/{operation_id}",)),
    "WaitOperation": (_FOLLOW_LONG, ("GET /v1/operations/{operation_id}:wait",)),
    "WatchOperation": (_FOLLOW_LONG, ("GET /v1/operations/{operation_id}/events",)),
    "CancelOperation": (_EDIT, ("POST /v1/operations/{operation_id}:cancel",)),
    "FinishOperation": (_EDIT, ("POST /v1/operations/{operation_id}:finish",)),
    "GetPreview": (
        _READ,
        ("GET /v1/operations/{operation_id}/preview", "GET /v1/operations/{operation_id}/preview.jpg"),
    ),
    "GetPlacedCameras": (_READ, ("GET /v1/operations/{operation_id}/cameras",)),
    "RetryOperation": (_EDIT, ("POST /v1/operations/{operation_id}:retry",)),
    "Query": (_SHOW, ("GET /query", "POST /v1/scenes/{scene_id}:query", "GET /v1/scenes/{scene_id}/mask3d.bin")),
    "StreamQuery": (_FETCH, ()),
    "DownloadCameras": (_SHOW, ("GET /v1/scenes/{scene_id}/cameras",)),
    "RenderView": (
        _SHOW,
        (
            "POST /v1/scenes/{scene_id}:render",
            "GET /v1/scenes/{scene_id}/{kind}.png",
            "GET /v1/scenes/{scene_id}/{kind}.npy",
        ),
    ),
    "ListPhotos": (_SHOW, ("GET /v1/scenes/{scene_id}/photos",)),
    "DownloadPhoto": (_SHOW, ("GET /v1/scenes/{scene_id}/photo.jpg",)),
    "ListNextPhotos": (_SHOW, ("GET /v1/scenes/{scene_id}/next-photos",)),
    "GetGoal": (_SHOW, ("GET /v1/scenes/{scene_id}/goal",)),
    "ListDetections": (_SHOW, ("GET /v1/scenes/{scene_id}/detections",)),
    "Localize": (_SHOW, ("POST /v1/scenes/{scene_id}:localize",)),
    "ListBestViews": (_SHOW, ("GET /v1/scenes/{scene_id}/views",)),
    "DownloadScenePly": (_FETCH, ("GET /v1/scenes/{scene_id}/scene.ply",)),
    "CreateKey": (_ADMIN, ("POST /v1/keys",)),
    "CreateUploadKey": (_EDIT, ("POST /v1/upload-keys",)),
    "ListKeys": (_ADMIN, ("GET /v1/keys",)),
    "RevokeKey": (_ADMIN, ("POST /v1/keys/{key_id}:revoke",)),
    "ExpireKey": (_ADMIN, ("POST /v1/keys/{key_id}:expire",)),
    "GetServerStatus": (_FOLLOW, ("GET /v1/server/status",)),
    "ListKnownNames": (_READ, ("GET /v1/known-names",)),
    "DeleteKnownName": (_ADMIN, ("DELETE /v1/known-names/{name_id}",)),
    "DeleteKnownNames": (_ADMIN, ("DELETE /v1/known-names",)),
    "DownloadMaskPly": (_SHOW, ("GET /v1/scenes/{scene_id}/mask.ply",)),
    "ExportScene": (_FETCH, ("GET /v1/scenes/{scene_id}/scene.{format}",)),
    "DownloadThingIds": (_SHOW, ("GET /v1/scenes/{scene_id}/things.bin",)),
}

_ONE_PROTOCOL: Mapping[str, Rule] = {
    # The page and the API's description hold nothing of anybody; a browser cannot send a key to ask for them.
    "GET /": _OPEN,
    "GET /docs": _OPEN,
    "GET /openapi.json": _OPEN,
    "MOUNT /docs-files": _OPEN,
    "MOUNT /web": _OPEN,
    "GET /livez": _OPEN,
    "GET /readyz": _OPEN,
    "/grpc.health.v1.Health/Check": _OPEN,
    "/grpc.health.v1.Health/List": _OPEN,
    "/grpc.health.v1.Health/Watch": _OPEN,
    "/grpc.reflection.v1alpha.ServerReflection/ServerReflectionInfo": _WATCH,
    "GET /v1/server": _SHOW,
    "POST /mcp": _FETCH,  # each tool then makes calls of the table above, with the same key
    # tus, by which CreateScene's files may come over HTTP
    "OPTIONS /v1/uploads": _FOLLOW,
    "POST /v1/uploads": _UPLOAD,
    "HEAD /v1/uploads/{upload_id}": _MANAGE_UPLOAD,
    "PATCH /v1/uploads/{upload_id}": _UPLOAD,
    "DELETE /v1/uploads/{upload_id}": _MANAGE_UPLOAD,
}

_SERVICE = fastsplat_pb2.DESCRIPTOR.services_by_name["SceneService"].full_name

RULES: Mapping[str, Rule] = {
    **{f"/{_SERVICE}/{rpc}": rule for rpc, (rule, _) in _CALLS.items()},
    **{route: rule for rule, routes in _CALLS.values() for route in routes},
    **_ONE_PROTOCOL,
}
"""Every rule by "METHOD /path/{template}", "MOUNT /path" or "/package.Service/Method"."""


def rule_of(route: str) -> Rule:
    """The rule of a route, named as in `RULES`; one that is not there needs an operator."""
    return RULES.get(route, _OPERATE)


def is_known_route(route: str) -> bool:
    """Whether the table names this route."""
    return route in RULES
