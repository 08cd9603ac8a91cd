"""Which releases fit: the rule, and that a client says what to do about a server that does not fit."""

from __future__ import annotations

import warnings
from importlib.metadata import version

import pytest

from fastsplat_client.releases import ReleaseWarning, advice, fitting
from fastsplat_contract.server.server_info import ServerInfo


@pytest.mark.parametrize(
    ("client", "server", "said"),
    [
        ("1.2.0", "1.2.9", ""),
        ("1.2.0", "1.3.0", ""),
        ("1.3.0", "1.2.0", "upgrade the server to 1.3.0 or later"),
        ("1.9.0", "2.0.0", 'run: pip install "fastsplat-client~=2.0.0"'),
        ("2.0.0", "1.9.0", "upgrade the server"),
        ("0.1.0", "0.1.7", ""),
        ("0.1.0", "0.2.0", 'run: pip install "fastsplat-client~=0.2.0"'),
        ("0.2.0.dev3", "0.2.0", ""),
        ("0.2.0", "unknown", ""),
    ],
)
def test_what_is_said_of_two_releases(client: str, server: str, said: str) -> None:
    message = advice(client, server)
    assert bool(message) == bool(said) and said in message
    if said:
        assert client in message and server in message


def test_a_server_that_does_not_fit_is_warned_of_and_answers_all_the_same() -> None:
    far = ServerInfo("999.0.0", None)
    with pytest.warns(ReleaseWarning, match="fastsplat-client~=999"):
        assert fitting(far) is far
    near = ServerInfo(version("fastsplat-client"), None)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert fitting(near) is near
