"""The fenced blocks of a Markdown page, and what is to be done with each."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

from markdown_it import MarkdownIt

ROOT = Path(__file__).parents[2]
PAGES = (ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md")))
EXECUTED = ("sh", "python")
DISPLAY_ONLY = ("csv", "json", "nginx", "text")  # languages of blocks that nobody is to run

_MARK = re.compile(r"<!-- not executed: (.+?) -->\s*", re.DOTALL)


@dataclass(frozen=True)
class Block:
    """A fenced block."""

    page: str
    line: int
    language: str
    code: str
    reason: str

    def __str__(self) -> str:
        return f"{self.page}:{self.line}"

    @property
    def is_executed(self) -> bool:
        return self.language in EXECUTED and not self.reason


def blocks_of(page: Path) -> list[Block]:
    """A page's blocks; `ValueError` if malformed. After `<!-- not executed: reason -->`, a block is run by no test."""
    name = str(page.relative_to(ROOT))
    found: list[Block] = []
    mark = ""
    for token in MarkdownIt("commonmark").enable("table").parse(page.read_text()):
        if token.type == "html_block" and "not executed" in token.content:
            matched = _MARK.fullmatch(token.content)
            if matched is None or mark:
                raise ValueError(f"{name}: write <!-- not executed: reason -->, not {token.content!r}")
            mark = " ".join(matched.group(1).split())
        elif token.type == "code_block":
            raise ValueError(f"{name}: put a fence with a language around {token.content[:60]!r}")
        elif token.type == "fence":
            language = token.info.partition(" ")[0]
            if language not in (*EXECUTED, *DISPLAY_ONLY):
                known = ", ".join((*EXECUTED, *DISPLAY_ONLY))
                raise ValueError(f"{name}:{token.map[0] + 1}: a block in {language!r}, which is none of {known}")
            found.append(Block(name, token.map[0] + 2, language, token.content, mark))
            mark = ""
        elif mark and token.type not in ("paragraph_close", "list_item_open", "list_item_close"):
            raise ValueError(f"{name}: a mark ({mark}) that stands before no block")
    return found


def links_of(page: Path) -> list[str]:
    """Targets of a page's links and pictures, in order."""
    targets = []
    for token in MarkdownIt("commonmark").enable("table").parse(page.read_text()):
        for child in token.children or ():
            target = child.attrGet("href") or child.attrGet("src")
            if target is not None:
                targets.append(str(target))
    return targets
