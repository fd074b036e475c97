"""Distribute the scenes of a global batch over devices.

Any dealing gives the same step: devices get equally many scenes, their gradients are averaged, and what is seen of a
scene depends on seed, epoch and scene alone. It decides only how long they wait for each other.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from heapq import heappop, heappush
from typing import Protocol, TypeVar, runtime_checkable

Draw = TypeVar("Draw")


@runtime_checkable
class Dealing(Protocol):
    """Divides draws into parts of equal size: a function of the draws, their triangles and the number of parts.

    All ranks compute it for themselves, so they must come to the same result. Draws keep their order within a part.
    """

    def __call__(self, draws: Sequence[Draw], triangles_of: Callable[[Draw], int], parts: int) -> list[list[Draw]]: ...


class InOrder:
    """In the order of the draws; does not need triangle counts."""

    def __call__(self, draws: Sequence[Draw], triangles_of: Callable[[Draw], int], parts: int) -> list[list[Draw]]:
        share = len(draws) // parts
        return [list(draws[i * share : (i + 1) * share]) for i in range(parts)]


class BySize:
    """Balances the triangle counts of the parts.

    From the largest scene to the smallest, each goes to the part that has the least so far and is not full: longest
    processing time first (Graham 1969), with equal numbers. Parts are numbered by their first draws, so that no
    device gets the largest scene more often than others.

    A scene's triangles stand for what there is to compute: on a line over them lie the counted operations of
    RenderFormer++, within 2% at the paper's sizes, and views cost the same in every scene.
    """

    def __call__(self, draws: Sequence[Draw], triangles_of: Callable[[Draw], int], parts: int) -> list[list[Draw]]:
        if parts == 1:
            return [list(draws)]
        triangles = [triangles_of(draw) for draw in draws]
        dealt: list[list[int]] = [[] for _ in range(parts)]
        lightest = [(0, part) for part in range(parts)]
        for position in sorted(range(len(draws)), key=triangles.__getitem__, reverse=True):
            load, part = heappop(lightest)
            dealt[part].append(position)
            if len(dealt[part]) < len(draws) // parts:
                heappush(lightest, (load + triangles[position], part))
        return [[draws[position] for position in part] for part in sorted(map(sorted, dealt))]
