"""Which dictionaries of questions may not be told apart by cross-validation: those that share labels."""

from __future__ import annotations

from collections.abc import Sequence

from fastsplat.service.common.dictionary import label_key

_SHARED = 1 / 3
"""Of the labels of the smaller dictionary; twins share more."""


def twin_groups(dictionaries: Sequence[Sequence[str]]) -> list[int]:
    """The group of each dictionary, numbered by its first member: those are in one group that share more than a third
    of the labels of the smaller one, directly or by way of others."""
    labels = [{label_key(label) for label in dictionary} for dictionary in dictionaries]
    group = list(range(len(labels)))
    for place, mine in enumerate(labels):
        for other_place in range(place):
            if len(mine & labels[other_place]) > _SHARED * min(len(mine), len(labels[other_place])):
                joined, target = sorted((group[place], group[other_place]), reverse=True)
                group = [target if number == joined else number for number in group]
    return group


def folds_of(dictionaries: Sequence[Sequence[str]], count: int) -> list[int]:
    """The fold 0..`count` − 1 of each dictionary: a group of twins as a whole, the largest first, each into the fold
    that has the fewest dictionaries yet (ties: the first)."""
    groups = twin_groups(dictionaries)
    sizes = [0] * count
    fold_of_group: dict[int, int] = {}
    for group in sorted(set(groups), key=lambda group: (-groups.count(group), group)):
        fold_of_group[group] = sizes.index(min(sizes))
        sizes[fold_of_group[group]] += groups.count(group)
    return [fold_of_group[group] for group in groups]
