"""Recordings by name: files, and the walks that the package makes itself."""

from __future__ import annotations

import os
from collections.abc import Sequence

from pedjax.errors import InputError
from pedjax.readers import read
from pedjax.recording import Recording
from pedjax.simulation import demo_walk


def is_demo(name: str) -> bool:
    """Whether a name stands for a walk that the package makes: `demo` or `demo:SEED`."""
    return name == "demo" or name.startswith("demo:")


def read_any(name: str | os.PathLike[str], config: str | None = None, sensor: str | None = None) -> Recording:
    """A file, or `demo` / `demo:SEED`."""
    name = os.fspath(name)
    if is_demo(name):
        seed = name.removeprefix("demo").removeprefix(":") or "0"
        if not seed.isdigit():
            raise InputError(f"'{name}': the seed of a demo walk is a whole number, as in demo:3")
        return demo_walk(int(seed))
    return read(name, config=config, sensor=sensor)


def read_all(
    names: Sequence[str | os.PathLike[str]], config: str | None = None, sensor: str | None = None
) -> list[Recording]:
    """All of them, in order."""
    return [read_any(name, config, sensor) for name in names]
