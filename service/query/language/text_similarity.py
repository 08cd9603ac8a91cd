"""Cosines of questions and dictionary entries, corrected by the grammar of the question."""

from __future__ import annotations

from collections.abc import Sequence

from fastsplat.service.query.language.embeddings import TextCache
from fastsplat.service.query.language.name_matching import NameMatch
from fastsplat.service.query.language.noun_phrases import noun_phrase
from fastsplat.service.query.language.relevancy import F32, F64, cosines


def text_similarity(
    texts: Sequence[str],
    matches: Sequence[NameMatch],
    labels: F32,
    cache: TextCache,
    templates: Sequence[str] | None = None,
) -> F64:
    """float64 [Q, N], cosines of questions and entries.

    A shared word lifts a cosine whatever its part in the question: MiniLM has "picture of a dog" nearer to "dog" than
    to "picture". So an entry that the question only mentions (`NameMatch.mentions`) is no closer than it is to the
    words that remain without it: "wall" is as close to "wall clock" as to "clock".

    Args:
        texts: Q questions.
        matches: what each of them names.
        labels: float32 [N, E], unit length.
        cache: embeds texts.
        templates: sentences that names are put into, in place of the cache's own.
    """
    similarity = cosines(cache.embed([noun_phrase(text) for text in texts], templates), labels)
    remainders = list(dict.fromkeys(words for match in matches for words in match.mentions.values()))
    if remainders:
        without_name = dict(zip(remainders, cosines(cache.embed(remainders, templates), labels), strict=True))
        for row, match in enumerate(matches):
            for label_id, words in match.mentions.items():
                entry = label_id - 1
                similarity[row, entry] = min(similarity[row, entry], without_name[words][entry])
    return similarity
