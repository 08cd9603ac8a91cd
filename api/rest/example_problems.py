"""Examples of errors in the API's description, by status class and reason."""

from __future__ import annotations

from collections.abc import Mapping

from fastsplat_contract.errors import FastSplatError, InvalidInputError, NotFoundError, OverloadedError

PROBLEMS: Mapping[str, Mapping[str, FastSplatError]] = {
    "4XX": {
        "NotFound": NotFoundError("no scene 'table'", field="scene_id"),
        "InvalidInput": InvalidInputError(
            "a coverage of 2", field="coverage", limit="above 0 and below 1", hint="Send a share, e.g. 0.9."
        ),
    },
    "5XX": {
        "Overloaded": OverloadedError(
            "the server has all the work it can answer in good time",
            limit="256 calls of all keys at a time (FASTSPLAT_LIMITS__ADMITTED)",
            hint="Wait a moment, then send it again.",
        )
    },
}
