"""Relation of an answer's leading entry to the question: same, kind, part or related."""

from __future__ import annotations

from fastsplat.service.query.language.meaning.label_meanings import BASE, Comparison
from fastsplat.service.query.language.words.judgement import Verdict
from fastsplat.service.query.language.words.name_matching import NameMatch
from fastsplat_contract.messages.queries import Relation, RelationSubject

Related = tuple[Relation, RelationSubject | None]

_STANDING: tuple[Related, ...] = (("same", None), ("kind_of", "label"))


def stands_for(row: int, match: NameMatch, comparison: Comparison | None) -> bool:
    """True if an entry is the thing asked for, a synonym or a kind."""
    if row + 1 in (*match.exact, *match.heads):
        return True
    if comparison is not None:
        known_as = comparison.columns[row, BASE.index("known_as")] > 0
        if known_as or (comparison.relations.same[row] > 0 and comparison.meaning.whole):
            return True
    return answer_relation("related", row, match, comparison) in _STANDING


def answer_relation(verdict: Verdict, row: int, match: NameMatch, comparison: Comparison | None) -> Related:
    """Relation of an entry to the question, and the one that is kind or part.

    Grammar precedes the lexicon: "coffee machine" is a kind of machine whether a lexicon has it or not.

    Args:
        verdict: of the answer.
        row: of the leading entry, label id - 1.
        match: names in the question.
        comparison: lexicon relations of question and entries; None without a lexicon.
    """
    if verdict == "absent" or verdict == "undecided":
        return verdict, None
    if verdict == "exact":
        return "same", None
    if row + 1 in match.hyponyms:
        return "kind_of", "label"
    if comparison is None:
        return "related", None
    relations = comparison.relations
    if comparison.compounds.kept[row]:
        return "kind_of", "question"
    if comparison.compounds.feigned[row] or comparison.compounds.other[row]:
        return "related", None
    if not comparison.meaning.whole:  # only the head is known: what is added to it makes a kind of it
        below = relations.same[row] > 0 or relations.narrower[row] > 0
        return ("kind_of", "question") if below else ("related", None)
    if relations.wider[row] > 0:
        return "kind_of", "label"
    if relations.narrower[row] > 0:
        return "kind_of", "question"
    if relations.part[row] > 0:
        return "part_of", "question"
    if relations.whole[row] > 0:
        return "part_of", "label"
    known = dict(zip(BASE, comparison.columns[row].tolist(), strict=True))
    if known["known_kind"]:
        return "kind_of", "label"
    if known["known_below"]:
        return "kind_of", "question"
    return "related", None
