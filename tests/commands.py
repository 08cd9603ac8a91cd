"""Commands of this process, whose command line is built once: a process that a person starts needs one, tests many."""

from __future__ import annotations

from functools import cache
from typing import Any

import pytest
from typer import testing

from fastsplat.cli.main import app

_built = cache(testing._get_command)


def invoke(*words: str, **options: Any) -> testing.Result:
    """Runs `fastsplat WORDS`; `options` are those of typer's `CliRunner.invoke`."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(testing, "_get_command", _built)
        return testing.CliRunner().invoke(app, words, **options)
