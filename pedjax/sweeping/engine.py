"""Parameter sets side by side in lanes, blocks of them on every device, scores only."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.typing import ArrayLike

from pedjax import parameters
from pedjax.ensemble import Problem, in_blocks, scores, walks_for
from pedjax.errors import InputError, suggest
from pedjax.evaluation.landmarks import ALIGNMENTS
from pedjax.evaluation.scores import score_kind, told_with
from pedjax.packing import Batch, alike, chunk_of, pack, sizes_of
from pedjax.recording import Clock, Recording
from pedjax.runtime import lane_count
from pedjax.shapes import columns_of, padded
from pedjax.sweeping.designs import Design, with_settings
from pedjax.systems import system as find_system
from pedjax.walks import Sensors, Walk, check_walk, distinct, sensor_names

_SAMPLES_AT_ONCE = 8_000_000
"""Samples of recordings on a device at a time (half a GiB): more are swept in parts, one after the other."""

_STEPS_IN_A_PART = 50_000_000
"""Filter steps computed between two looks at the clock, at the keyboard and at the disk: about a second."""

_TIMES_ON_A_GPU = 80
"""How many times as many on a GPU, for about the same time."""


@dataclass(frozen=True)
class Sweep:
    """`values` of each path and `settings` `(N,)`; `scores[column] (N, R)` of each set on each recording
    `names`, NaN where it was not healthy; its `status` (0: healthy), and the mean weight of each of the
    `gates` by name, `(N, R)`; `chosen` names the score that `loss`, `mean` and `best` go by."""

    names: tuple[str, ...]
    values: dict[str, np.ndarray]
    settings: dict[str, list[Any]]
    scores: dict[str, np.ndarray]
    status: np.ndarray
    gates: dict[str, np.ndarray]
    chosen: str

    @property
    def healthy(self) -> np.ndarray:
        """`(N, R)` bool."""
        return self.status == 0

    @property
    def loss(self) -> np.ndarray:
        """The chosen loss `(N, R)`, inf where a run was not healthy."""
        found = self.scores[score_kind(self.chosen).column]
        return np.where(np.isfinite(found), found, np.inf)

    @property
    def mean(self) -> np.ndarray:
        """Mean loss over recordings `(N,)`."""
        return self.loss.mean(axis=1)

    @property
    def best(self) -> int:
        """Row of the best set."""
        return int(np.argmin(self.mean))


@dataclass(frozen=True)
class Job:
    """Everything that a sweep's parts have in common: recordings ready for the filter, parameters around
    which sets vary, and how they are scored."""

    problem: Problem
    params: Any
    walks: tuple[Walk, ...]
    dtype: Any
    sensors: Mapping[str, str]
    site: Any = None

    @property
    def names(self) -> tuple[str, ...]:
        """Recordings, each name once."""
        return tuple(distinct([w.name for w in self.walks]))

    @property
    def samples(self) -> int:
        """Samples of all recordings: filter steps of one parameter set."""
        return sum(map(len, self.walks))

    @property
    def part(self) -> int:
        """Parameter sets in a part: a matter of the recordings and the kind of device alone, so that every
        machine of a kind and any number of its devices cut the same sweep into the same parts."""
        times = 1 if jax.default_backend() == "cpu" else _TIMES_ON_A_GPU
        sets = max(times * _STEPS_IN_A_PART // self.samples, 1)
        return sets if sets < 64 else sets // 64 * 64


def job(
    recordings: Sequence[Recording],
    system: Any = "iez",
    params: Any = None,
    *,
    loss: str = "armse",
    alignment: str = "yaw_translation",
    sensor: Sensors = None,
    clock: Clock | None = None,
    site: Any = None,
) -> Job:
    """Check everything and make recordings ready, before anything compiles."""
    chosen = find_system(system)
    params = chosen.defaults() if params is None else params
    score_kind(loss)
    if alignment not in ALIGNMENTS:
        raise InputError(f"alignment '{alignment}' is unknown{suggest(alignment, ALIGNMENTS)}")
    walks = walks_for(chosen, params, recordings, sensor, clock, loss)
    names = sensor_names(chosen.needs, sensor)
    return Job(Problem(chosen, loss, alignment), params, tuple(walks), jnp.result_type(float), names, site)


def check_design(job: Job, design: Design) -> None:
    """Refuse paths that are no numbers or have no effect, and settings that a recording is too short for,
    before anything compiles."""
    known = parameters.specs(job.params)
    for path in design.values:
        if path not in known:
            parameters.get(job.params, path)
            raise InputError(f"'{path}' is a setting, not a number that can be swept; give it in settings")
    chosen = [parameters.replace(job.params, settings) for settings, _, _ in design.groups()]
    for path in design.values:
        reasons = [parameters.idle_because(params, path) for params in chosen]
        if all(reasons):
            raise InputError(f"'{path}' has no effect: {reasons[0]}")
    for params in chosen:
        for walk in job.walks:
            check_walk(job.problem.system, params, walk)


def parts_of(design: Design, size: int) -> list[tuple[int, int]]:
    """Stretches of at most `size` sets, none of which crosses a change of settings."""
    return [
        (first, min(first + size, stop))
        for _, start, stop in design.groups()
        for first in range(start, stop, size)
    ]


class Engine:
    """Runs parameter sets of one job on all local devices; keeps what it packed and compiled.

    `run(settings, values)` takes values `(n,)` of each path and gives columns `(n, R)`; n up to `capacity`
    shares one program.
    """

    def __init__(self, job: Job, capacity: int, devices: Sequence[jax.Device] | None = None) -> None:
        self.job = job
        self.devices = list(devices or jax.local_devices())
        self.sets, self.columns = _shape_of_block(job, capacity)
        self.blocks = -(-capacity // (self.sets * len(self.devices)))
        self.shares = _shares(job.walks)
        self.order = [r for share in self.shares for r in share]
        self._packed: dict[tuple[Any, ...], list[tuple[Any, list[Batch]]]] = {}

    def run(self, settings: Mapping[str, Any], values: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
        """Columns of the scores, `healthy`, `status`, and `GATE_fraction` of each gate, each `(n, R)`;
        scores NaN where unhealthy."""
        packed = self._ready(settings)
        count = len(next(iter(values.values())))
        shares = np.array_split(np.arange(-(-count // self.sets)), len(self.devices))

        def on(device: int) -> list[dict[str, np.ndarray]]:
            """Blocks of one device; lanes and blocks to spare repeat the last set."""
            params, batches = packed[device]
            first, used = shares[device][0], len(shares[device])
            index = (first + np.arange(self.blocks))[:, None] * self.sets + np.arange(self.sets)
            index = np.minimum(index, count - 1)
            laid = {path: np.asarray(v, self.job.dtype)[index] for path, v in values.items()}
            laid = jax.device_put(laid, self.devices[device])
            found = [_blocks(self.job.problem, params, laid, used, batch) for batch in batches]
            return [{k: np.asarray(v)[:used] for k, v in piece.items()} for piece in found]

        def in_precision(device: int) -> list[dict[str, np.ndarray]]:
            with jax.enable_x64(self.job.dtype == jnp.float64):  # the choice is each thread's own
                return on(device)

        # each device has a thread and a program of its own, the same for one device and for many, so that
        # a sweep's numbers are the same to the last bit (a program partitioned over devices rounds otherwise)
        busy = [d for d, share in enumerate(shares) if len(share)]
        with ThreadPoolExecutor(len(busy)) as pool:
            pieces = list(pool.map(in_precision, busy))
        found = {}
        for name in pieces[0][0]:
            whole = np.concatenate([np.concatenate([p[name] for p in piece], axis=-1) for piece in pieces])
            found[name] = whole.reshape(-1, whole.shape[-1])[:count][:, np.argsort(self.order)]
        return found

    def _ready(self, settings: Mapping[str, Any]) -> list[tuple[Any, list[Batch]]]:
        """Parameters and packed recordings for those settings, on each device."""
        key = tuple(settings.items())
        if key not in self._packed:
            self._packed.clear()  # settings come in stretches: one at a time is all that is needed
            with jax.enable_x64(self.job.dtype == jnp.float64):
                params = parameters.cast(parameters.replace(self.job.params, settings), self.job.dtype)
                batches = [
                    pack(
                        self.job.problem.system,
                        params,
                        [self.job.walks[r] for r in share],
                        self.job.dtype,
                        most_columns=self.columns,
                        site=self.job.site,
                    )
                    for share in self.shares
                ]
                self._packed[key] = [jax.device_put((params, batches), d) for d in self.devices]
        return self._packed[key]


@partial(jax.jit, static_argnames="problem")
def _blocks(
    problem: Problem, params: Any, values: dict[str, Array], used: ArrayLike, batch: Batch
) -> dict[str, Array]:
    """Columns `(B, S, R)` of blocks of sets `(B, S)`, one after the other, the first `used` of them."""

    def columns(block: dict[str, Array]) -> dict[str, Array]:
        found = scores(problem, params, block, batch)
        table = {
            kind.column: jnp.where(found.status == 0, found.errors[kind.name], jnp.nan)
            for kind in told_with(problem.loss)
        }
        gates = {f"{name}_fraction": weight for name, weight in found.gates.items()}
        return {**table, "healthy": found.status == 0, "status": found.status, **gates}

    found: dict[str, Array] = in_blocks(columns, values, used)
    return found


def _shape_of_block(job: Job, count: int) -> tuple[int, int]:
    """How many sets and how many columns of recordings share the lanes of a block, so that few are idle."""
    lanes = lane_count(job.dtype)
    sizes = sizes_of(job.walks, chunk_of(job.walks))
    best, fewest = (lanes, 1), float("inf")
    sets = lanes
    while sets >= 1:
        columns = columns_of(sizes, lanes // sets)
        cost = -(-count // sets) * lanes * padded(sizes, columns) / len(columns)
        if cost < 0.98 * fewest:
            best, fewest = (sets, len(columns)), cost
        sets //= 2
    return best


def _shares(walks: Sequence[Walk]) -> list[list[int]]:
    """Numbers of recordings of one sampling rate, in parts that fit into memory at once."""
    shares: list[list[int]] = []
    for group in alike(walks):
        shares.append([])
        filled = 0
        for r in group:
            if shares[-1] and filled + len(walks[r]) > _SAMPLES_AT_ONCE:
                shares.append([])
                filled = 0
            shares[-1].append(r)
            filled += len(walks[r])
    return shares


def sweep(
    recordings: Sequence[Recording],
    values: Mapping[str, np.ndarray],
    system: Any = "iez",
    params: Any = None,
    *,
    settings: Mapping[str, Sequence[Any]] | None = None,
    loss: str = "armse",
    alignment: str = "yaw_translation",
    sensor: Sensors = None,
    clock: Clock | None = None,
    site: Any = None,
    devices: Sequence[jax.Device] | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> Sweep:
    """Run every parameter set `values[path] (N,)` over every recording and keep the scores only.

    With `settings` (path to a list of choices) all sets are run for each combination of them. For sweeps that
    are too long to lose, see `sweeping.store` and the command line.
    """
    counts = {len(v) for v in values.values()}
    if len(counts) != 1 or counts == {0}:
        raise InputError(f"every swept parameter needs equally many values, not {sorted(counts)}")
    work = job(
        recordings, system, params, loss=loss, alignment=alignment, sensor=sensor, clock=clock, site=site
    )
    design = with_settings((), values, settings or {})
    check_design(work, design)
    parts = parts_of(design, work.part)
    engine = Engine(work, max(stop - start for start, stop in parts), devices)
    found = []
    for start, stop in parts:
        found.append(engine.run(*slice_of(design, start, stop)))
        if progress is not None:
            progress(stop, design.count)
    whole = {name: np.concatenate([f[name] for f in found]) for name in found[0]}
    return Sweep(
        names=work.names,
        values=design.values,
        settings=design.settings,
        scores={kind.column: whole[kind.column] for kind in told_with(loss)},
        status=whole["status"],
        gates={name: whole[f"{name}_fraction"] for name in work.problem.system.gates},
        chosen=loss,
    )


def slice_of(design: Design, start: int, stop: int) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    """Settings and values of the sets of one part."""
    settings = {path: column[start] for path, column in design.settings.items()}
    return settings, {path: v[start:stop] for path, v in design.values.items()}
