"""Processes that work on one sweep together: who takes which part.

`jax.distributed` starts them and tells each its number; the parts are shared out through the store's folder,
which all of them see. Whoever is free takes the next part, so that none is idle while there is work.
"""

from __future__ import annotations

import os
import secrets
import shutil
import time
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

import jax
import numpy as np

_POLL_S = 0.2
T = TypeVar("T")


@dataclass(frozen=True)
class Team:
    """This process is number `index` of `count`; `token` is new for each job."""

    index: int = 0
    count: int = 1
    token: str = "alone"

    @property
    def leads(self) -> bool:
        """Whether this process does what is to be done once."""
        return self.index == 0


def assemble() -> Team:
    """The processes of this `jax.distributed` job, or this one alone. All of them wait here for the first."""
    count = jax.process_count()
    if count == 1:
        return Team()
    from jax.experimental import multihost_utils

    mine = np.array(secrets.randbelow(2**31 - 1), np.int32)
    return Team(jax.process_index(), count, f"{int(multihost_utils.broadcast_one_to_all(mine)):08x}")


def shared_out(team: Team, place: Path, parts: Iterable[int]) -> Iterator[int]:
    """The parts that fall to this process, one at a time."""
    if team.count == 1:
        yield from parts
        return
    claims = place / f".claims-{team.token}"
    claims.mkdir(exist_ok=True)
    for part in parts:
        try:
            os.close(os.open(claims / str(part), os.O_CREAT | os.O_EXCL | os.O_WRONLY))
        except (FileExistsError, FileNotFoundError):  # taken by another, or all done and cleared away
            continue
        yield part


def disband(team: Team, place: Path) -> None:
    """Clear the claims of this job away."""
    if team.leads:
        shutil.rmtree(place / f".claims-{team.token}", ignore_errors=True)


def wait_for(ready: Callable[[], T | None]) -> T:
    """What `ready` gives once another process has done its share: anything but None and False."""
    while not (found := ready()):
        time.sleep(_POLL_S)
    return found
