"""Recordings by name: files, and the walks that the package makes itself."""

from __future__ import annotations

import os
from collections.abc import Sequence

from pedjax.errors import InputError
from pedjax.readers import read
from pedjax.recording import Recording
from pedjax.simulation.scenarios import scenarios
from pedjax.simulation.world import simulate


def is_made(name: str) -> bool:
    """Whether a name stands for a walk that the package makes: a scenario that comes along, as `demo` or
    `office-loop:3` (`SCENARIO:SEED`)."""
    return name.partition(":")[0] in scenarios()


def read_any(name: str | os.PathLike[str], config: str | None = None, sensor: str | None = None) -> Recording:
    """A file, or `SCENARIO:SEED`."""
    name = os.fspath(name)
    if is_made(name):
        scenario, _, seed = name.partition(":")
        if not (seed or "0").isdigit():
            raise InputError(f"'{name}': the seed of a made walk is a whole number, as in {scenario}:3")
        return simulate(scenario, int(seed or "0")).recording
    return read(name, config=config, sensor=sensor)


def read_all(
    names: Sequence[str | os.PathLike[str]], config: str | None = None, sensor: str | None = None
) -> list[Recording]:
    """All of them, in order."""
    return [read_any(name, config, sensor) for name in names]
