"""What is decided of questions, before it is put into words."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from fastsplat.service.query.language.judgement import Ranked
from fastsplat.service.query.language.query_text import check_query
from fastsplat.service.query.scene_index import SceneIndex


def decided(index: SceneIndex, *texts: str, **choices: Any) -> Sequence[Ranked]:
    """What comes before the answers of `index.ask`."""
    return index.ranked.decided(check_query(texts, index.settings, **choices), lambda: index.things)
