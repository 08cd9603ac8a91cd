"""Senses, definitions and relations out of files in WordNet's format, made here."""

from __future__ import annotations

from pathlib import Path

import pytest

from fastsplat.service.perception.lexicon.wordnet import FILES, Lexicon, open_lexicon
from fastsplat_contract.errors import ModelUnavailableError

_NOTICE = "  1 This file was made for a test.  \n  2 Its first lines are indented, as the license is.  \n"
# id, lexicographer file, words, the names of what it is a kind of and of its parts, gloss
_SYNSETS = (
    ("object", 3, ("object",), (), (), "what there is"),
    ("fruit", 13, ("fruit",), ("object",), (), 'what a plant bears; "ripe fruit"'),
    ("banana", 13, ("banana",), ("fruit",), ("peel",), 'a long yellow fruit; sweet; "he ate a banana"'),
    ("peel", 13, ("peel", "skin"), ("object",), (), "the rind of a fruit"),
    ("tool", 6, ("tool",), ("object",), (), "what work is done with"),
    ("axe", 6, ("axe", "ax"), ("tool",), (), "an edge on a handle"),
    ("ice_axe", 6, ("ice_axe",), ("axe", "fruit"), (), "an axe for climbers"),
    ("box", 6, ("box",), ("object",), (), "a container with a lid"),
    ("box2", 4, ("box",), ("object",), (), "a blow with the hand"),
)


def _write(folder: Path) -> Path:
    """The synsets as files of WordNet."""
    folder.mkdir(exist_ok=True)

    def line(key: str, place: dict[str, int]) -> str:
        _, lexfile, words, wider, parts, gloss = next(row for row in _SYNSETS if row[0] == key)
        pointers = [("@", name) for name in wider] + [("%p", name) for name in parts]
        links = "".join(f" {symbol} {place.get(name, 0):08d} n 0000" for symbol, name in pointers)
        spelled = "".join(f" {word} 0" for word in words)
        start = f"{place.get(key, 0):08d} {lexfile:02d} n {len(words):02x}"
        return f"{start}{spelled} {len(pointers):03d}{links} | {gloss}  \n"

    place, end = dict[str, int](), len(_NOTICE)
    for key, *_ in _SYNSETS:
        place[key] = end
        end += len(line(key, {}))
    (folder / "data.noun").write_text(_NOTICE + "".join(line(key, place) for key, *_ in _SYNSETS))
    by_word: dict[str, list[int]] = {}
    for key, _, words, *_ in _SYNSETS:
        for word in words:
            by_word.setdefault(word, []).append(place[key])
    rows = [
        f"{word} n {len(at)} 2 @ ~ {len(at)} 0 " + " ".join(f"{offset:08d}" for offset in at) + "  \n"
        for word, at in sorted(by_word.items())
    ]
    (folder / "index.noun").write_text(_NOTICE + "".join(rows))
    (folder / "index.verb").write_text(_NOTICE + "cut v 1 1 @ 1 0 00000099  \nopen v 1 1 @ 1 0 00000199  \n")
    (folder / "data.verb").write_text(_NOTICE)
    return folder


@pytest.fixture
def lexicon(tmp_path: Path) -> Lexicon:
    return Lexicon(_write(tmp_path / "wordnet"))


def test_every_word_is_found_and_no_other(lexicon: Lexicon) -> None:
    words = {word.replace("_", " ") for _, _, words, *_ in _SYNSETS for word in words}
    for word in words:
        assert all(word in sense.words for sense in lexicon.senses(word)) and lexicon.senses(word)
    for absent in ("", " ", "a", "zz", "banan", "bananaa", "1", "Its", "indented,", "ice", "_", "\0", "茶"):
        assert lexicon.senses(absent) == (), absent


def test_a_sense_says_what_its_line_says(lexicon: Lexicon) -> None:
    (banana,) = lexicon.senses("banana")
    assert (banana.lexical_class, banana.words) == ("food", ("banana",))
    assert banana.definition == "a long yellow fruit; sweet"
    assert [lexicon.sense(part).words for part in banana.parts] == [("peel", "skin")]
    assert [sense.lexical_class for sense in lexicon.senses("box")] == ["artifact", "act"]


@pytest.mark.parametrize(("noun", "singular"), [("Bananas", "banana"), ("boxes", "box"), ("ICE  axes", "ice axe")])
def test_plurals_and_capitals_mean_the_same(lexicon: Lexicon, noun: str, singular: str) -> None:
    assert lexicon.senses(noun) == lexicon.senses(singular) != ()


def test_wider_counts_the_steps(lexicon: Lexicon) -> None:
    (ice_axe,) = lexicon.senses("ice axe")
    steps = {lexicon.sense(place).words[0]: count for place, count in lexicon.wider(ice_axe.id).items()}
    assert steps == {"ice axe": 0, "axe": 1, "fruit": 1, "tool": 2, "object": 2}


def test_verbs_are_known(lexicon: Lexicon) -> None:
    assert lexicon.is_verb("cut") and lexicon.is_verb("Open") and not lexicon.is_verb("banana")


@pytest.mark.parametrize("file", FILES)
@pytest.mark.parametrize("content", [None, b""])
def test_a_missing_or_empty_file_is_named(tmp_path: Path, file: str, content: bytes | None) -> None:
    folder = _write(tmp_path / "wordnet")
    (folder / file).unlink()
    if content is not None:
        (folder / file).write_bytes(content)
    with pytest.raises(ModelUnavailableError) as refusal:
        open_lexicon("wordnet", tmp_path)
    assert refusal.value.field == file


def test_files_that_contradict_each_other_are_refused(tmp_path: Path) -> None:
    folder = _write(tmp_path / "wordnet")
    data = (folder / "data.noun").read_bytes()
    (folder / "data.noun").write_bytes(data[:40] + b"x" + data[40:])
    with pytest.raises(ModelUnavailableError, match=r"data\.noun"):
        Lexicon(folder).senses("banana")
    (folder / "data.noun").write_bytes(data[: len(data) // 2])
    with pytest.raises(ModelUnavailableError, match=r"data\.noun"):
        Lexicon(folder).senses("box")
    index = (folder / "index.noun").read_text().replace("axe n 1 2", "axe n x 2")
    (folder / "index.noun").write_text(index)
    with pytest.raises(ModelUnavailableError, match=r"index\.noun"):
        Lexicon(folder).senses("axe")


def test_bytes_that_are_no_text_are_no_crash(tmp_path: Path) -> None:
    folder = _write(tmp_path / "wordnet")
    for seed in range(64):
        (folder / "index.noun").write_bytes(bytes((seed * 31 + k * k) % 256 for k in range(400)))
        try:
            Lexicon(folder).senses("banana")
        except ModelUnavailableError:
            continue
