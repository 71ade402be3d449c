"""Few shapes to compile: lengths rounded up, items laid into columns of equal length."""

from __future__ import annotations

import heapq
from collections.abc import Sequence


def bucket(length: int, parts: int = 8) -> int:
    """The next length m·2ᵉ with m from `parts` to twice that: few shapes to compile, 1/`parts` of padding at
    most."""
    step = 1 << max(length.bit_length() - parts.bit_length(), 0)
    return -(-length // step) * step


def columns_of(sizes: Sequence[int], most: int) -> list[list[int]]:
    """Items of those sizes in columns: as many, up to `most`, as cost at most a twentieth more than one."""
    tried = [_fill(sizes, count) for count in range(1, min(most, len(sizes)) + 1)]
    return next(way for way in reversed(tried) if padded(sizes, way) <= 1.05 * sum(sizes))


def padded(sizes: Sequence[int], columns: Sequence[Sequence[int]]) -> int:
    """What items of those sizes take in columns of equal length."""
    return len(columns) * max(sum(sizes[r] for r in members) for members in columns)


def _fill(sizes: Sequence[int], count: int) -> list[list[int]]:
    """The longest first, each into the emptiest column."""
    heap = [(0, c) for c in range(count)]
    columns: list[list[int]] = [[] for _ in range(count)]
    for r in sorted(range(len(sizes)), key=lambda r: -sizes[r]):
        filled, c = heapq.heappop(heap)
        columns[c].append(r)
        heapq.heappush(heap, (filled + sizes[r], c))
    return columns
