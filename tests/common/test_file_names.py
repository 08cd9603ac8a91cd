"""Names that clients choose: what is accepted can be written below a folder and nowhere else."""

from __future__ import annotations

from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from fastsplat.service.common.file_names import is_system_file, safe_parts
from fastsplat_contract.errors import InvalidInputError

_LETTERS = st.characters(codec=None) | st.sampled_from("./\\: C\x00\u202e\udc80")


@pytest.mark.parametrize(
    ("name", "problem"),
    [
        ("", "empty"), (".", "empty"), ("/etc/passwd", "absolute"), ("//host/share", "absolute"), ("C:/a", "absolute"),
        ("./C:/a", "absolute"), ("c:a", "absolute"), ("..", "'..'"), ("../a", "'..'"), ("a/../../b", "'..'"),
        ("a\\b", "backslash"), ("..\\a", "backslash"), ("a\0b", "control"), ("a\nb", "control"),
        ("a\x85b", "control"), ("a\udc80b", "not text"), ("x" * 256, "255 bytes"), ("ü" * 128, "255 bytes"),
        ("a/" * 16 + "a", "16 folders"),
    ],
)  # fmt: skip
def test_unsafe_names(name: str, problem: str) -> None:
    with pytest.raises(InvalidInputError, match="not safe") as caught:
        safe_parts(name)
    assert problem in caught.value.message and caught.value.hint
    caught.value.message.encode()


@pytest.mark.parametrize(
    ("name", "parts"),
    [
        ("a.jpg", ("a.jpg",)),
        ("./set/a.jpg", ("set", "a.jpg")),
        ("set//./ü b.jpg", ("set", "ü b.jpg")),
        ("..a/b..", ("..a", "b..")),
        ("a/" * 15 + "a", ("a",) * 16),
        ("x" * 255, ("x" * 255,)),
        ("shot 12:30.jpg", ("shot 12:30.jpg",)),
    ],
)
def test_safe_names(name: str, parts: tuple[str, ...]) -> None:
    assert safe_parts(name) == parts


@given(st.text(_LETTERS, max_size=40))
def test_what_is_accepted_lies_below_the_folder(name: str) -> None:
    try:
        parts = safe_parts(name)
    except InvalidInputError:
        return
    folder = Path("/some/folder")
    path = folder.joinpath(*parts)
    assert path.parts == (*folder.parts, *parts) and path.resolve().is_relative_to(folder)


def test_system_files() -> None:
    for name in ("__MACOSX/a.jpg", ".DS_Store", "set/.hidden/a.jpg", "Thumbs.db", "set/desktop.ini"):
        assert is_system_file(Path(name).parts)
    assert not is_system_file(("set", "a.jpg"))
