"""Access policy: role and cost by matched route; unlisted routes need an operator."""

from __future__ import annotations

from collections.abc import Mapping

from fastsplat_contract.call import Rule
from fastsplat_contract.calls import CALLS, FETCH, FOLLOW, OPERATE, SHOW, UPLOAD
from fastsplat_contract.v1 import fastsplat_pb2

_OPEN = Rule(None)
_WATCH = Rule("reader", long_lived=True)
_MANAGE_UPLOAD = Rule("editor", also=("uploader",))

UNMATCHED = Rule("reader", long_lived=True)
"""Rule of unknown paths and methods: any key may learn that they do not exist."""

_ONE_PROTOCOL: Mapping[str, Rule] = {
    # The page and the API's description are public; a browser cannot send a key with these requests.
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
    "GET /v1/server": SHOW,
    "POST /mcp": FETCH._replace(also=("suggester",)),  # each tool makes calls of the contract's table with the same key
    # tus: resumable uploads for CreateScene
    "OPTIONS /v1/uploads": FOLLOW,
    "POST /v1/uploads": UPLOAD,
    "HEAD /v1/uploads/{upload_id}": _MANAGE_UPLOAD,
    "PATCH /v1/uploads/{upload_id}": UPLOAD,
    "DELETE /v1/uploads/{upload_id}": _MANAGE_UPLOAD,
}

_SERVICE = fastsplat_pb2.DESCRIPTOR.services_by_name["SceneService"].full_name

RULES: Mapping[str, Rule] = {
    **{f"/{_SERVICE}/{call.rpc}": call.rule for call in CALLS},
    **{route: call.rule for call in CALLS for route in call.routes},
    **_ONE_PROTOCOL,
}
"""Rules by "METHOD /path/{template}", "MOUNT /path" or "/package.Service/Method"."""


def rule_of(route: str) -> Rule:
    return RULES.get(route, OPERATE)


def is_known_route(route: str) -> bool:
    return route in RULES
