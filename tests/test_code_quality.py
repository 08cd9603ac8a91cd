"""The house rules, checked as a newcomer's editor would: lint, format, strict types, walls between rooms."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
_LONGEST_FILE = 400


@pytest.mark.parametrize(
    "command",
    [
        ("ruff", "check", "."),
        ("ruff", "format", "--check", "."),
        ("mypy",),
        ("lint-imports",),
    ],
    ids=lambda command: " ".join(command),
)
def test_tool_is_content(command: tuple[str, ...]) -> None:
    tool = Path(sys.executable).parent / command[0]
    result = subprocess.run([tool, *command[1:]], cwd=ROOT, capture_output=True, text=True, check=False)
    assert result.returncode == 0, result.stdout + result.stderr


def test_files_can_be_read_in_one_sitting() -> None:
    listed = subprocess.run(["git", "ls-files"], cwd=ROOT, capture_output=True, text=True, check=True).stdout.split(
        "\n"
    )
    sources = [ROOT / name for name in listed if name.endswith((".py", ".cpp", ".hpp", ".js", ".html"))]
    written = [path for path in sources if path.exists() and "_pb2" not in path.name]
    assert written
    too_long = {
        str(path.relative_to(ROOT)): n for path in written if (n := path.read_text().count("\n")) > _LONGEST_FILE
    }
    assert not too_long
