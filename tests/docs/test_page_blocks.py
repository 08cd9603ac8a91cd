"""No code escapes the tests of pages unseen, and links lead somewhere."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest

from tests.docs import page_blocks
from tests.docs.page_blocks import PAGES, ROOT, blocks_of, links_of

_FENCE = "```"


@pytest.fixture
def page(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setattr(page_blocks, "ROOT", tmp_path)
    return tmp_path / "page.md"


def test_a_mark_with_its_reason_belongs_to_the_next_block_alone(page: Path) -> None:
    page.write_text(
        f"<!-- not executed: needs a\nGPU -->\n{_FENCE}sh\nnvidia-smi\n{_FENCE}\n"
        f"text\n\n{_FENCE}python\nx = 1\n{_FENCE}\n"
    )
    first, second = blocks_of(page)
    assert (first.reason, first.line, first.is_executed) == ("needs a GPU", 4, False)
    assert (second.reason, second.code, second.is_executed) == ("", "x = 1\n", True)


@pytest.mark.parametrize(
    ("text", "what"),
    [
        (f"{_FENCE}\nfastsplat serve\n{_FENCE}\n", "a block in ''"),
        (f"{_FENCE}py\nx = 1\n{_FENCE}\n", "a block in 'py'"),
        ("Do this:\n\n    fastsplat serve\n", "put a fence"),
        ("<!-- not executed: a GPU -->\n\nNothing.\n", "stands before no block"),
        (f"<!-- not executed -->\n{_FENCE}sh\nls\n{_FENCE}\n", "write <!--"),
    ],
)
def test_code_that_would_escape_is_refused(page: Path, text: str, what: str) -> None:
    page.write_text(text)
    with pytest.raises(ValueError, match=re.escape(what)):
        blocks_of(page)


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_links_of_a_page_lead_somewhere(page: Path) -> None:
    for target in links_of(page):
        path, _, anchor = target.partition("#")
        if ":" in path:
            continue
        file = page.parent / path if path else page
        assert file.resolve().is_relative_to(ROOT) and file.exists(), target
        if anchor and file.suffix == ".md":
            assert anchor in _anchors(file), target


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_json_of_a_page_is_json(page: Path) -> None:
    for block in blocks_of(page):
        if block.language == "json":
            json.loads(block.code)


def _anchors(page: Path) -> set[str]:
    """Of a page's headings, as GitHub and mkdocs make them."""
    headings = re.findall(r"^#+ (.+)$", page.read_text(), re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).strip().replace(" ", "-") for heading in headings}
