"""The demonstration's gRPC calls: the same questions over the other protocol."""

from __future__ import annotations

from typing import Any

import grpc

from fastsplat.v1 import fastsplat_pb2 as pb
from fastsplat.v1 import fastsplat_pb2_grpc as rpc


def query(port: int, key: str, scene_id: str, text: str) -> dict[str, Any]:
    """The ranked answer as the REST face words it, for comparison."""
    with grpc.insecure_channel(f"127.0.0.1:{port}") as channel:
        replies = rpc.SceneServiceStub(channel).Query(
            pb.QueryRequest(scene_id=scene_id, texts=[text]), metadata=(("authorization", f"Bearer {key}"),)
        )
        answer = next(iter(replies)).answer
    return {
        "text": answer.text,
        "verdict": pb.Verdict.Name(answer.verdict).removeprefix("VERDICT_").lower(),
        "results": [
            {"label": match.label, "relevancy": match.relevancy, "gaussian_count": match.gaussian_count}
            for match in answer.matches
        ],
    }
