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


def _cpp_sources() -> list[Path]:
    return sorted(path for path in (ROOT / "service").rglob("*") if path.suffix in (".cpp", ".h"))


def test_cpp_is_formatted_and_fits_into_120_columns() -> None:
    sources = _cpp_sources()
    assert sources
    tool = Path(sys.executable).parent / "clang-format"
    result = subprocess.run(
        [tool, "--dry-run", "-Werror", *sources], cwd=ROOT, capture_output=True, text=True, check=False
    )
    assert result.returncode == 0, result.stderr
    lines = [(path.name, n, line) for path in sources for n, line in enumerate(path.read_text().splitlines(), 1)]
    assert not [f"{name}:{n}" for name, n, line in lines if len(line) > 120]


def test_the_stub_of_the_extension_is_what_the_extension_says(tmp_path: Path) -> None:
    """Otherwise `make stubs` writes it anew."""
    stub = tmp_path / "_cpu.pyi"
    module = "fastsplat.service.splatting.raster._cpu"
    bin_dir = Path(sys.executable).parent
    for command in (
        (sys.executable, "-m", "nanobind.stubgen", "-q", "-m", module, "-o", stub),
        (bin_dir / "ruff", "format", "-q", "--config", ROOT / "pyproject.toml", stub),
    ):
        result = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
        assert result.returncode == 0, result.stdout + result.stderr
    assert stub.read_text() == (ROOT / "service/splatting/raster/_cpu.pyi").read_text()


def test_files_can_be_read_in_one_sitting() -> None:
    listed = subprocess.run(["git", "ls-files"], cwd=ROOT, capture_output=True, text=True, check=True).stdout.split(
        "\n"
    )
    sources = [ROOT / name for name in listed if name.endswith((".py", ".cpp", ".h", ".hpp", ".js", ".html"))]
    written = [path for path in sources if path.exists() and "_pb2" not in path.name]
    assert written
    too_long = {
        str(path.relative_to(ROOT)): n for path in written if (n := path.read_text().count("\n")) > _LONGEST_FILE
    }
    assert not too_long
