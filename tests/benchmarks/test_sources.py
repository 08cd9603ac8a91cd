"""What counts as a changed source of a benchmark, and what does not; git is not asked."""

from __future__ import annotations

from pathlib import Path

import pytest

from benchmarks.sources import changes_since, module_of, sources_of

_TREE = {
    "benchmarks/probe/__main__.py": "from fastsplat.service import store\n\nstore.read('fastsplat.cli.main')\n",
    "benchmarks/probe/words.txt": "cup mug",
    "fastsplat/service/store.py": 'import json\n\ndef read(name: str) -> str:\n    """Reads."""\n    return name\n',
    "fastsplat/cli/main.py": "from fastsplat.raster._cpu import draw\n\nLIMIT = 3\n",
    "fastsplat/raster/_cpu.pyi": "def draw() -> None: ...\n",
    "fastsplat/raster/cpp/draw.cpp": "int draw() { return 1; }  // once",
    "fastsplat/cli/beside.py": "LIMIT = 4\n",
}


_SAME = {
    "fastsplat/service/store.py": '"""New."""\nimport json\ndef read(name: str) -> str: return (  # it\n  name)\n',
    "fastsplat/raster/cpp/draw.cpp": "/* twice\n */ int draw() {\n  return 1;\n}",
    "fastsplat/cli/beside.py": "LIMIT = 5\n",
    "benchmarks/probe/notes.md": "",
}
_CHANGED = {  # one file of six
    "fastsplat/service/store.py": "import json\n\ndef read(name: str) -> str:\n    return name + '.'\n",
    "fastsplat/cli/main.py": "from fastsplat.raster._cpu import draw\n\nLIMIT = None\n",
    "fastsplat/raster/cpp/draw.cpp": "int draw() { return 2; }",
    "benchmarks/probe/words.txt": "cup mugs",
}


@pytest.mark.parametrize(("name", "text", "said"), [
    *((name, text, "its sources are today's") for name, text in _SAME.items()),
    *((name, text, "since then 1 of 6 sources changed") for name, text in _CHANGED.items()),
])  # fmt: skip
def test_a_change_of_meaning_is_counted_without_a_repository(tmp_path: Path, name: str, text: str, said: str) -> None:
    for folder, files in (("then", _TREE), ("now", {**_TREE, name: text})):
        for file, content in files.items():
            (tmp_path / folder / file).parent.mkdir(parents=True, exist_ok=True)
            (tmp_path / folder / file).write_text(content)
    then, now = ({"sources": sources_of("benchmarks.probe", tmp_path / folder)} for folder in ("then", "now"))
    assert changes_since(then, "benchmarks.probe", tmp_path / "now") == said
    assert changes_since(now, "benchmarks.probe", tmp_path / "now") == "its sources are today's"
    assert changes_since({}, "benchmarks.probe", tmp_path / "now") == "its sources were not recorded"
    assert module_of("probe", "python -m benchmarks.moved", tmp_path / "now") == "benchmarks.probe"
