"""What the leading entry of an answer is to the question: the same, a kind, a part, or something related."""

from __future__ import annotations

from fastsplat.service.query.language.meaning.label_meanings import BASE, Comparison
from fastsplat.service.query.language.words.judgement import Verdict
from fastsplat.service.query.language.words.name_matching import NameMatch
from fastsplat_contract.messages.queries import Relation, RelationSubject

Related = tuple[Relation, RelationSubject | None]

_STANDING: tuple[Related, ...] = (("same", None), ("kind_of", "label"))


def stands_for(row: int, match: NameMatch, comparison: Comparison | None) -> bool:
    """Whether what the entry in a row names is what the question asks for: by its name, a synonym, or as a kind of it,
    and not merely something that may serve in its place."""
    if row + 1 in (*match.exact, *match.heads):
        return True
    if comparison is not None:
        known_as = comparison.columns[row, BASE.index("known_as")] > 0
        if known_as or (comparison.relations.same[row] > 0 and comparison.meaning.whole):
            return True
    return answer_relation("related", row, match, comparison) in _STANDING


def answer_relation(verdict: Verdict, row: int, match: NameMatch, comparison: Comparison | None) -> Related:
    """The relation of the entry in a row to the question, and which of the two is the kind or the part of the other.

    Grammar decides before the lexicon does: "coffee machine" is a kind of machine, and "kitchen chair" a kind of chair,
    whether a lexicon has them or not.

    Args:
        verdict: of the answer.
        row: of the leading entry, label id - 1.
        match: what the question names.
        comparison: what the lexicon says of question and entries; None: no lexicon was asked.
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
