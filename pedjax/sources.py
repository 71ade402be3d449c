"""Recordings by name: files, and the walks that the package makes itself."""

from __future__ import annotations

from collections.abc import Sequence

from pedjax.errors import InputError
from pedjax.readers import read
from pedjax.recording import Recording
from pedjax.simulation import demo_walk


def read_any(name: str, config: str | None = None, sensor: str | None = None) -> Recording:
    """A file, or `demo` / `demo:SEED`."""
    head, colon, seed = name.partition(":")
    if head == "demo" and (colon or not seed):
        if colon and not seed.isdigit():
            raise InputError(f"'{name}': the seed of a demo walk is a whole number, as in demo:3")
        return demo_walk(int(seed or 0))
    return read(name, config=config, sensor=sensor)


def read_all(names: Sequence[str], config: str | None = None, sensor: str | None = None) -> list[Recording]:
    """All of them, in order."""
    return [read_any(name, config, sensor) for name in names]
