"""A sweep of any size into a store: part by part, round by round, resumed where it was stopped."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from typing import Any

import jax
import numpy as np

from pedjax import parameters
from pedjax.evaluation.scores import score_kind
from pedjax.identity import fingerprint, fingerprint_of, streams
from pedjax.recording import Recording
from pedjax.sweeping import store as keep
from pedjax.sweeping.designs import Design, lay_out
from pedjax.sweeping.engine import Engine, Job, check_design, parts_of, slice_of
from pedjax.sweeping.store import Store
from pedjax.sweeping.team import Team, disband, shared_out, wait_for
from pedjax.version import __version__
from pedjax.walks import Walk

Progress = Callable[[int, int], None]
"""Called with the runs that are done and their number."""


@dataclass(frozen=True)
class Rounds:
    """`refine` further rounds of `count` sets each, on axes that are `shrink` times as long as in the round
    before, around the best set so far."""

    refine: int = 0
    shrink: float = 0.3
    count: int = 0
    kind: str = "sobol"
    seed: int = 0


def manifest_of(
    job: Job, recordings: Sequence[Recording], design: Design, rounds: Rounds, about: dict[str, Any]
) -> dict[str, Any]:
    """All that decides the numbers of a sweep, and what is needed to read them."""
    digest = hashlib.sha256()
    for path, values in design.values.items():
        digest.update(path.encode() + np.ascontiguousarray(values).tobytes())
    digest.update(repr(design.settings).encode())
    return {
        "format": keep.FORMAT,
        "pedjax_version": __version__,
        "jax_version": jax.__version__,
        "system": job.problem.system.name,
        "loss": job.problem.loss,
        "alignment": job.problem.alignment,
        "precision": np.dtype(job.dtype).name,
        "sensors": dict(job.sensors),
        "site": _site(job.site),
        "recordings": recordings_of(job, recordings),
        "axes": [axis._asdict() for axis in design.axes],
        "settings": {path: sorted(set(column), key=str) for path, column in design.settings.items()},
        "design": digest.hexdigest()[:16],
        "rounds": asdict(rounds),
        "runs_in_first_round": design.count,
        "runs_in_a_part": job.part,
        "parameters": parameters.to_nested(job.params),
        **about,
    }


def recordings_of(job: Job, recordings: Sequence[Recording]) -> list[dict[str, Any]]:
    """Each recording's name, fingerprint, hashes of its streams and of what it is scored by."""
    entries: list[dict[str, Any]] = []
    for name, recording, walk in zip(job.names, recordings, job.walks, strict=True):
        found = streams(recording)
        entries.append(
            {"name": name, "fingerprint": fingerprint_of(found), "streams": found, "scored": _scored(walk)}
        )
    return entries


def _scored(walk: Walk) -> str:
    """A short hash of what a fingerprint leaves out: the clock as read, and the points a run is scored at."""
    digest = hashlib.sha256()
    attitude = np.zeros(0) if walk.attitude is None else walk.attitude
    for values in (walk.imu.time, walk.index, walk.position, attitude):
        digest.update(np.ascontiguousarray(values).tobytes())
    return digest.hexdigest()[:16]


def _site(site: Any) -> str:
    """A short hash of the data beside the samples; empty where there is none."""
    leaves = jax.tree.leaves(site)
    digest = hashlib.sha256()
    for leaf in leaves:
        values = np.ascontiguousarray(leaf)
        digest.update(f"{values.dtype}{values.shape}".encode() + values.tobytes())
    return digest.hexdigest()[:16] if leaves else ""


def run_campaign(
    job: Job,
    recordings: Sequence[Recording],
    first: Design,
    rounds: Rounds,
    store: Store,
    team: Team = Team(),  # noqa: B008
    devices: Sequence[jax.Device] | None = None,
    progress: Progress | None = None,
) -> None:
    """Compute what the store lacks. With several processes, all of them call this and return together."""
    prints = [fingerprint(r) for r in recordings]
    check_design(job, first)
    if team.leads:
        if team.count == 1:  # a team tidies up before it assembles
            keep.tidy(store)
        if not keep.design_path(store, 0).exists():
            keep.write_design(store, 0, first, 0)
    run = part = 0
    for number in range(rounds.refine + 1):
        if team.leads and not keep.design_path(store, number).exists():
            keep.write_design(store, number, _closer(job, store, first, rounds, number), run)
        design = wait_for(partial(keep.read_design, store, number))
        parts = parts_of(design, job.part)
        rest = keep.missing(store, parts, part, len(job.walks))
        sizes = {part + i: stop - start for i, (start, stop) in enumerate(parts)}
        done = run + design.count - sum(sizes[n] for n in rest)
        total = run + design.count + (rounds.refine - number) * (design.count if number else rounds.count)
        if progress is not None:
            progress(done, total)
        engine = Engine(job, max(sizes.values()), devices) if rest else None
        for n in shared_out(team, store.path, rest):
            assert engine is not None
            start, stop = parts[n - part]
            found = engine.run(*slice_of(design, start, stop))
            keep.write_part(store, n, _rows(job, prints, design, start, stop, run, number, found))
            done += sizes[n]
            if progress is not None:
                progress(_done(store, sizes, rest, run, design) if team.count > 1 else done, total)
        wait_for(partial(_is_complete, store, parts, part, len(job.walks)))
        run, part = run + design.count, part + len(parts)
        if progress is not None:
            progress(run, total)
    disband(team, store.path)


def _is_complete(store: Store, parts: Sequence[tuple[int, int]], first: int, recordings: int) -> bool:
    return not keep.missing(store, parts, first, recordings)


def _done(store: Store, sizes: dict[int, int], rest: Sequence[int], run: int, design: Design) -> int:
    """Runs finished by all processes together."""
    return run + design.count - sum(sizes[n] for n in rest if not keep.part_path(store, n).exists())


def _rows(
    job: Job,
    prints: Sequence[str],
    design: Design,
    start: int,
    stop: int,
    first_run: int,
    number: int,
    found: dict[str, np.ndarray],
) -> dict[str, Any]:
    """Columns of a part: a row for each run and recording, recordings fastest."""
    count, recordings = stop - start, len(job.names)

    def each_run(values: Any) -> np.ndarray:
        return np.repeat(np.asarray(values), recordings)

    columns: dict[str, Any] = {
        "run": each_run(np.arange(first_run + start, first_run + stop)),
        "round": np.full(count * recordings, number, np.int32),
        "recording": list(job.names) * count,
        "fingerprint": list(prints) * count,
    }
    columns |= {path: each_run(column[start:stop]).tolist() for path, column in design.settings.items()}
    columns |= {path: each_run(values[start:stop]) for path, values in design.values.items()}
    return {**columns, **{name: values.reshape(-1) for name, values in found.items()}}


def _closer(job: Job, store: Store, first: Design, rounds: Rounds, number: int) -> Design:
    """The next round's sets, around the best so far and with its settings."""
    _, columns = keep.read_store(store.path)
    score = columns[score_kind(job.problem.loss).column].astype(float)
    runs = columns["run"]
    mean = np.bincount(runs, np.where(np.isfinite(score), score, np.inf)) / len(job.names)
    row = int(np.flatnonzero(runs == int(np.argmin(mean)))[0])
    axes = tuple(axis.zoomed(float(columns[axis.path][row]), rounds.shrink**number) for axis in first.axes)
    values = lay_out(axes, rounds.count, rounds.kind, rounds.seed + number)
    settings = {path: [columns[path][row]] * len(next(iter(values.values()))) for path in first.settings}
    return Design(axes, values, settings)
