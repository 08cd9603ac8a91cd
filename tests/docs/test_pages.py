"""Every block of the documentation that can run does, as it stands on its page, against a real server."""

from __future__ import annotations

import re
import subprocess
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from tests.docs.page_blocks import PAGES, ROOT, Block, blocks_of
from tests.docs.page_reader import PageReader

_BLOCKS = {page.name: blocks_of(page) for page in PAGES}
_WITH_CODE = [name for name, blocks in _BLOCKS.items() if any(block.is_executed for block in blocks)]


@pytest.mark.parametrize("name", _WITH_CODE)
def test_the_blocks_of_a_page_run(name: str, new_reader: Callable[[str], PageReader]) -> None:
    reader = new_reader(Path(name).stem)
    for block in _BLOCKS[name]:
        if block.is_executed:
            reader.run(block)


def test_what_is_not_executed_is_the_lesser_part() -> None:
    code = [block for blocks in _BLOCKS.values() for block in blocks if block.language in ("sh", "python")]
    left_out = [block for block in code if block.reason]
    for block in left_out:
        print(f"{block}: {block.reason}")
    assert len(code) > 30
    assert len(left_out) <= len(code) / 4, [f"{block}: {block.reason}" for block in left_out]


def test_each_way_to_the_photos_of_the_quickstart_leads_to_the_folder_that_its_blocks_use(tmp_path: Path) -> None:
    way_to_photos = re.compile(r"`((?:mkdir [^`]+)?cp -r demo/sample[^`]*)`")
    (page,) = (text for path in PAGES if way_to_photos.search(text := path.read_text()))
    ways = way_to_photos.findall(page)
    (checked,) = re.findall(r"fastsplat check (\S+)", page)
    assert len(ways) == 2
    for number, way in enumerate(ways):
        folder = tmp_path / str(number)
        folder.mkdir()
        (folder / "demo").symlink_to(ROOT / "demo")
        subprocess.run(["bash", "-ec", way], cwd=folder, check=True)
        assert list((folder / checked).glob("*.jpg")), way


@pytest.fixture
def reader(tmp_path: Path, small_environment: dict[str, str], programs: Path) -> Iterator[PageReader]:
    """Of a page whose port 8000 is 4711."""
    (tmp_path / "page").mkdir()
    reader = PageReader(tmp_path / "page", small_environment, {8000: 4711}, programs)
    yield reader
    reader.close()


@pytest.mark.parametrize(
    ("language", "code"),
    [
        ("sh", "[ -z nothing ]"),
        ("sh", "false | cat"),
        ("sh", "echo $NOT_SET"),
        ("sh", "fastsplat no-such-command | cat"),
        ("sh", "kill -9 $(fastsplat --version > /dev/null && echo $$)"),
        ("python", "raise ValueError('no')"),
        ("python", "import sys; sys.exit(1)"),
        ("python", "import os; os._exit(0)"),
    ],
)
def test_a_block_that_fails_fails_its_page(language: str, code: str, reader: PageReader) -> None:
    with pytest.raises(AssertionError, match=r"page\.md:7"):
        reader.run(Block("page.md", 7, language, code, ""))


def test_sessions_keep_what_was_defined_in_them(reader: PageReader, tmp_path: Path) -> None:
    blocks = [
        ("sh", "say() { echo \"$WORD\"; }\nWORD='two words'\nmkdir inner && cd inner"),
        ("sh", "say > said.txt\necho localhost:8000 localhost:9 >> said.txt"),
        ("python", "import os\nword = os.environ['WORD']"),
        ("python", "from pathlib import Path\nPath('python.txt').write_text(word)"),
    ]
    for language, code in blocks:
        reader.run(Block("page.md", 1, language, code, ""))
    assert (tmp_path / "page" / "inner" / "said.txt").read_text() == "two words\nlocalhost:4711 localhost:9\n"
    assert (tmp_path / "page" / "python.txt").read_text() == "two words"
