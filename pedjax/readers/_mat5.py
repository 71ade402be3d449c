"""A look over the tags of a MATLAB 5 file before scipy reads it: scipy ends the process on damaged ones."""

from __future__ import annotations

import struct
import zlib

_HEADER = 128
_MATRIX, _COMPRESSED, _INT8, _INT32, _UINT32 = 14, 15, 1, 5, 6
_DATA = frozenset((1, 2, 3, 4, 5, 6, 7, 9, 12, 13, 16, 17, 18))
_TEXT, _NUMBERS = 4, range(6, 16)
_COMPLEX = 0x800


def plain_variables(data: bytes) -> list[str]:
    """The names of the numeric and text variables; `ValueError` where a tag cannot be right.

    Cells, structs, objects and sparse matrices are left out: no format here needs them.
    """
    order = {b"IM": "<", b"MI": ">"}.get(data[126:128])
    if order is None:
        raise ValueError("its header is no MATLAB 5 header")
    names: list[str] = []
    at = _HEADER
    while at < len(data):
        kind, start, stop, at = _element(data, at, order, padded=False)
        if kind == _COMPRESSED:
            try:
                content = zlib.decompress(data[start:stop])
            except zlib.error as error:
                raise ValueError(str(error)) from error
            kind, start, stop, _ = _element(content, 0, order, padded=False)
        else:
            content = data
        if kind != _MATRIX:
            raise ValueError(f"a variable has type {kind}")
        name = _matrix(content[start:stop], order)
        if name:
            names.append(name)
    return names


def _matrix(body: bytes, order: str) -> str | None:
    kinds, spans, at = [], [], 0
    for _ in range(3):
        kind, start, stop, at = _element(body, at, order)
        kinds.append(kind)
        spans.append((start, stop))
    if kinds != [_UINT32, _INT32, _INT8] or spans[0][1] - spans[0][0] != 8 or (spans[1][1] - spans[1][0]) % 4:
        raise ValueError("a variable's head is damaged")
    flags = struct.unpack_from(order + "I", body, spans[0][0])[0]
    name = body[slice(*spans[2])].decode("latin-1")
    if flags & 0xFF != _TEXT and flags & 0xFF not in _NUMBERS:
        return None
    for _ in range(2 if flags & _COMPLEX else 1):
        kind, _, _, at = _element(body, at, order)
        if kind not in _DATA:
            raise ValueError(f"the data of '{name}' have type {kind}")
    return name


def _element(data: bytes, at: int, order: str, *, padded: bool = True) -> tuple[int, int, int, int]:
    """Type, start and stop of the element at `at`, and where the next one begins."""
    if at + 8 > len(data):
        raise ValueError("it is cut off")
    kind, size = struct.unpack_from(order + "II", data, at)
    if kind >> 16:  # a small element: size, type and up to four bytes in one tag
        kind, size = kind & 0xFFFF, kind >> 16
        if size > 4:
            raise ValueError("a small element is too long")
        return kind, at + 4, at + 4 + size, at + 8
    stop = at + 8 + size
    if stop > len(data):
        raise ValueError("it is cut off")
    return kind, at + 8, stop, stop + (-size % 8 if padded else 0)
