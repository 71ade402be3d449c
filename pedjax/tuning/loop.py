"""Gradient tuning: Adam in unconstrained space on the soft gate, selection on the hard one."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Future
from dataclasses import dataclass, field
from functools import partial
from threading import Thread
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import optax

from pedjax import parameters
from pedjax.ensemble import Problem, walks_for
from pedjax.errors import InputError, suggest
from pedjax.evaluation.landmarks import ALIGNMENTS
from pedjax.evaluation.scores import score_kind
from pedjax.gates import SoftGate
from pedjax.identity import walk_fingerprint
from pedjax.kernels.columns import on_gpu
from pedjax.packing import Batches, pack_all
from pedjax.parameters import Spec
from pedjax.recording import Clock, Recording
from pedjax.runtime import double_precision
from pedjax.system import System
from pedjax.systems import SYSTEMS
from pedjax.systems import system as find_system
from pedjax.tuning import augment, objective
from pedjax.tuning.augment import Augment
from pedjax.tuning.judging import Judge
from pedjax.tuning.split import refuse_overlap
from pedjax.walks import Sensors, distinct

MODES = ("auto", *objective.GRADIENTS)

Progress = Callable[[int, int, float], None]
"""Called with the iteration, their number, and the best loss so far."""


@dataclass(frozen=True)
class TuneSettings:
    """How to tune. Defaults suit a dozen walks and up to a dozen parameters.

    `names` dotted paths of leaves; `loss` a score (`evaluation.scores`: armse, rms_2d, mean_2d, max_2d,
    final_2d, rms_3d, heading_rms, or one of your own), averaged over recordings;
    `starts` the first at the given parameters, the others scattered by `spread` around it in free units
    (about e-folds); `grid` values tried on the hard gate before and half-way for each start, of each
    operating point of a detector that is among the names (0: none); `width` of the soft gate; `patience`
    checks without a better loss before stopping; `validation` part of the tuned-on recordings that gives no
    gradients: stop and winner are chosen by the hard-gate mean over those and the others together; `mode`
    of differentiation, reverse or forward (auto: what is faster on this kind of device); `augment` disturbed
    copies of each recording, for systems that look at the magnetic field. A copy is on the side of its
    recording: both give gradients, or both only help to choose.
    """

    names: tuple[str, ...]
    loss: str = "armse"
    alignment: str = "yaw_translation"
    iterations: int = 30
    starts: int = 2
    spread: float = 0.7
    grid: int = 9
    width: float = 0.25
    straight_through: bool = False
    learning_rate: float = 0.15
    clip: float = 1.0
    validation: float = 0.25
    check_every: int = 5
    patience: int = 4
    mode: str = "auto"
    seed: int = 0
    augment: Augment = field(default_factory=Augment)

    def __post_init__(self) -> None:
        names = (self.names,) if isinstance(self.names, str) else self.names
        object.__setattr__(self, "names", tuple(dict.fromkeys(map(str, names))))


@dataclass(frozen=True)
class Tuned:
    """What tuning found: `params`, hard-gate loss of each recording `before` and `after` for `tuned_on` and
    `held_back` (name to the `loss`), the `history` (a row per check: iteration, best and all starts' losses),
    how many filter runs it took (one parameter set over all that is tuned on is one), and fingerprints.

    Disturbed copies count in `history` and in the choice of the winner; `before` and `after` are of
    recordings alone, as they were measured."""

    params: Any
    names: tuple[str, ...]
    values: dict[str, float]
    before: dict[str, dict[str, float]]
    after: dict[str, dict[str, float]]
    history: list[dict[str, Any]] = field(repr=False)
    runs: dict[str, int]
    fingerprints: tuple[str, ...] = field(repr=False)
    loss: str = "armse"
    lost: int = 0
    """Slopes of one start by one parameter that were no numbers, and so moved nothing."""

    @property
    def warnings(self) -> tuple[str, ...]:
        """Why the tuned values may not suit other recordings."""
        return (*self._of_slopes(), *self._of_others())

    def _of_slopes(self) -> tuple[str, ...]:
        if not self.lost:
            return ()
        return (
            f"{self.lost} slopes were no numbers and moved nothing: the filter fails at some of the values "
            "tried; start from others, or tune fewer parameters (--names)",
        )

    def _of_others(self) -> tuple[str, ...]:
        if "held_back" not in self.before:
            return ("nothing was held back, so nobody knows what these values do elsewhere: try --split 0.7",)
        before, after = (np.mean(list(part["held_back"].values())) for part in (self.before, self.after))
        if after <= before:
            return ()
        return (
            "held-back recordings are worse than before: the values fit what they were tuned on; tune on "
            f"more than {len(self.before['tuned_on'])}, or fewer parameters than {len(self.names)} (--names)",
        )


def tune(
    recordings: Sequence[Recording],
    settings: TuneSettings,
    system: str | System = "iez",
    params: Any = None,
    *,
    held_back: Sequence[Recording] = (),
    sensor: Sensors = None,
    clock: Clock | None = None,
    site: Any = None,
    progress: Progress | None = None,
) -> Tuned:
    """Tune the named parameters on recordings, report hard-gate errors on them and on held-back ones.

    Runs in float64. A held-back recording that is also tuned on is an `InputError`. Disturbed copies
    (`settings.augment`) are made of `recordings` alone and never reported: they help to choose the
    parameters, and the errors told are those of walks as they were measured.
    """
    chosen = find_system(system)
    params = chosen.defaults() if params is None else params
    specs = _check(settings, params)
    _check_magnetic(settings, chosen)
    prints = tuple(walk_fingerprint(r) for r in recordings)
    refuse_overlap(prints, held_back)
    copies = augment.copies_of(recordings, settings.augment)
    walks = walks_for(chosen, params, [*recordings, *copies], sensor, clock, settings.loss)
    others = walks_for(chosen, params, held_back, sensor, clock, settings.loss)
    training, validation = _part(len(recordings), settings)
    problem = Problem(chosen, settings.loss, settings.alignment)
    with double_precision():
        hard = parameters.cast(gated(params, 0.0), float)
        pack = partial(pack_all, chosen, hard, site=site)
        most = settings.starts * max(settings.grid, 1)
        everything = pack(walks)
        judged = Judge(problem, hard, settings.names, everything, most)
        batches = pack([walks[i] for i in training]) if validation else everything
        search = _Search(problem, settings, specs, hard, judged, batches, (training, validation))
        best = search.run(progress)
        tuned = parameters.with_leaves(params, best)
        parts = {"tuned_on": (distinct([r.name for r in recordings]), judged)}
        if others:
            held = Judge(problem, hard, settings.names, pack(others), 1)
            parts["held_back"] = (distinct([w.name for w in others]), held)
        report = partial(_report, settings.names, parts)
        return Tuned(
            params=tuned,
            names=settings.names,
            values=best,
            before=report(params),
            after=report(tuned),
            history=search.history,
            runs=search.runs,
            fingerprints=prints,
            loss=settings.loss,
            lost=search.lost,
        )


def gate_widths(params: Any) -> list[str]:
    """Paths of the widths of all soft gates."""
    return [f"{path}.width" for path in parameters.groups_of(params, SoftGate)]


def gated(params: Any, width: float, straight_through: bool | None = None) -> Any:
    """The same parameters with every gate that soft (0: hard)."""
    changes: dict[str, Any] = dict.fromkeys(gate_widths(params), width)
    if straight_through is not None:
        siblings = (path.removesuffix("width") + "straight_through" for path in gate_widths(params))
        changes |= dict.fromkeys(siblings, straight_through)
    return parameters.replace(params, changes)


_LIMITS = (
    ("iterations", 1, 1e6), ("starts", 1, 1e4), ("check_every", 1, 1e6), ("spread", 0, 20), ("grid", 0, 1e4),
    ("width", 1e-3, 5), ("learning_rate", 1e-6, 10), ("clip", 1e-9, 1e9), ("validation", 0, 0.9),
    ("patience", 1, 1e6), ("seed", 0, 2**63),
)  # fmt: skip


def _check(settings: TuneSettings, params: Any) -> dict[str, Spec]:
    known = parameters.specs(params)
    if not settings.names:
        raise InputError("no parameter to tune was named; give dotted paths such as stance.shoe.threshold")
    for name in settings.names:
        if name not in known:
            parameters.get(params, name)  # raises with a suggestion where the path is unknown
            raise InputError(f"'{name}' is a setting, not a number that can be tuned")
        if name in gate_widths(params):
            raise InputError(f"{name} cannot be tuned: errors are judged on the hard gate; set tune.width")
        if idle := parameters.idle_because(params, name):
            raise InputError(f"'{name}' has no effect: {idle}")
    score_kind(settings.loss)
    if settings.alignment not in ALIGNMENTS:
        raise InputError(f"alignment '{settings.alignment}' is unknown; known are: {', '.join(ALIGNMENTS)}")
    if settings.mode not in MODES:
        raise InputError(f"mode '{settings.mode}' is unknown{suggest(settings.mode, MODES)}")
    for name, low, high in _LIMITS:
        value = getattr(settings, name)
        if not isinstance(value, int | float) or not low <= value <= high:
            raise InputError(f"tune.{name} = {value!r} must lie between {low:g} and {high:g}")
    augment.check(settings.augment)
    return {name: known[name] for name in settings.names}


def _check_magnetic(settings: TuneSettings, system: System) -> None:
    if settings.augment.copies and not system.magnetic:
        magnetic = ", ".join(s.name for s in SYSTEMS.values() if s.magnetic)
        raise InputError(
            f"tune.augment.copies = {settings.augment.copies}: the system '{system.name}' does not use a "
            f"magnetometer, and magnets change nothing; set it to 0, or choose another --system ({magnetic})"
        )


def _part(count: int, settings: TuneSettings) -> tuple[list[int], list[int]]:
    """Tuned-on recordings that give gradients (all, where few), and those that only help to choose, each with
    its own disturbed copies."""
    size = round(settings.validation * count)
    if size < 1 or count - size < 1:
        size = 0
    order = np.random.default_rng(settings.seed + 1).permutation(count)
    training, validation = (sorted(part.tolist()) for part in (order[size:], order[:size]))
    sides = partial(augment.with_copies, count=count, augment=settings.augment)
    return sides(training), sides(validation)


def starts(specs: Mapping[str, Spec], params: Any, settings: TuneSettings) -> dict[str, np.ndarray]:
    """Free numbers `(starts,)` of each parameter: the first at the given value, the others scattered around
    it, drawn in the order of the names."""
    rng = np.random.default_rng(settings.seed)
    free = {}
    for name, spec in specs.items():
        scatter = rng.normal(size=settings.starts) * settings.spread
        scatter[0] = 0.0
        free[name] = float(spec.to_free(parameters.get(params, name))) + scatter
    return free


class _Search:
    """The state of one tuning, kept on the host between jitted steps."""

    def __init__(
        self,
        problem: Problem,
        settings: TuneSettings,
        specs: Mapping[str, Spec],
        params: Any,
        judged: Judge,
        batches: Batches,
        parts: tuple[Sequence[int], Sequence[int]],
    ) -> None:
        self.problem, self.settings, self.specs, self.params = problem, settings, specs, params
        self.soft = parameters.cast(gated(params, settings.width, settings.straight_through), float)
        self.judged, self.batches = judged, batches
        self.training, self.validation = parts
        self.history: list[dict[str, Any]] = []
        self.runs = {"gradients": 0, "hard": 0}
        self.lost = 0

    def compiled(self, free: Mapping[str, Any]) -> Callable[[dict[str, Any]], dict[str, Any]]:
        """The gradient by the free numbers. It is compiled while the first hard runs go on: by the time it is
        asked for, much of that is done."""
        mode = self.settings.mode
        if mode == "auto":  # as measured: docs/benchmarks.md
            mode = "forward" if on_gpu() else "reverse"
        ready: Future[Any] = Future()

        def compile_it() -> None:
            try:
                with double_precision():  # the choice is each thread's own
                    given = {n: jnp.asarray(x) for n, x in free.items()}
                    lowered = objective.GRADIENTS[mode].lower(self.problem, self.soft, given, self.batches)
                    ready.set_result(lowered.compile())
            except BaseException as error:
                ready.set_exception(error)

        self.judged.trace()  # alone: two threads that trace at once take longer than one after the other
        Thread(target=compile_it).start()  # no daemon: the compiler must not run on while Python ends
        self.judged.compile()

        def gradient(free: dict[str, Any]) -> dict[str, Any]:
            given = {n: jnp.asarray(x) for n, x in free.items()}
            found: dict[str, Any] = ready.result()(self.soft, given, self.batches)[1]
            return found

        return gradient

    def values(self, free: Mapping[str, Any]) -> dict[str, np.ndarray]:
        return {name: np.asarray(self.specs[name].from_free(x)) for name, x in free.items()}

    def grid(self, free: dict[str, np.ndarray], width: float) -> dict[str, np.ndarray]:
        """For each start, the best of a grid of operating points around it, on the hard gate."""
        names = [name for name, spec in self.specs.items() if spec.point]
        for name in names if self.settings.grid > 1 else []:
            offsets = np.linspace(-width, width, self.settings.grid)
            tried = {n: np.repeat(x[:, None], len(offsets), axis=1) for n, x in free.items()}
            tried[name] = tried[name] + offsets
            flat = {n: x.reshape(-1) for n, x in tried.items()}
            each = self.judged(self.values(flat))[:, self.training]
            loss = each.mean(axis=1).reshape(-1, len(offsets))
            self.runs["hard"] += loss.size
            best = np.argmin(np.where(np.isfinite(loss), loss, np.inf), axis=1)
            free = {**free, name: tried[name][np.arange(len(best)), best]}
        return free

    def run(self, progress: Progress | None) -> dict[str, float]:
        settings = self.settings
        free = starts(self.specs, self.params, settings)
        gradient_of = self.compiled(free)
        free = self.grid(free, width=2.5)
        optimiser = optax.chain(
            _clip_each(settings.clip), optax.adam(settings.learning_rate, b1=0.8, b2=0.95)
        )
        state = optimiser.init({n: jnp.asarray(x) for n, x in free.items()})
        given = {n: np.array([float(parameters.get(self.params, n))]) for n in self.specs}
        best_loss = float(self._judge(given, iteration=-1)[0])
        best_values = {n: float(x[0]) for n, x in given.items()}
        stale = 0
        for iteration in range(settings.iterations + 1):
            if iteration % settings.check_every == 0 or iteration == settings.iterations:
                values = self.values(free)
                loss = self._judge(values, iteration)
                winner = int(np.argmin(loss))
                if loss[winner] < best_loss:
                    best_loss, stale = float(loss[winner]), 0
                    best_values = {n: float(x[winner]) for n, x in values.items()}
                else:
                    stale += 1
                if progress is not None:
                    progress(iteration, settings.iterations, best_loss)
                if stale >= settings.patience or iteration == settings.iterations:
                    break
            gradient = gradient_of(free)
            self.runs["gradients"] += settings.starts
            sound = {n: jnp.isfinite(g) for n, g in gradient.items()}
            self.lost += sum(int(np.sum(~np.asarray(ok))) for ok in sound.values())
            gradient = {n: jnp.where(sound[n], g, 0.0) for n, g in gradient.items()}
            updates, state = optimiser.update(gradient, state)
            free = {n: np.asarray(free[n] + updates[n]) for n in free}
            if iteration == settings.iterations // 2:
                free = self.grid(free, width=0.8)
        return best_values

    def _judge(self, values: Mapping[str, np.ndarray], iteration: int) -> np.ndarray:
        """The loss that selects: hard gate, over training and validation recordings alike."""
        each = self.judged(values)
        training = each[:, self.training].mean(axis=1)
        row: dict[str, Any] = {"iteration": iteration, "training": training.tolist()}
        loss = training
        if len(self.validation):
            validation = each[:, self.validation].mean(axis=1)
            row["validation"] = validation.tolist()
            share = len(self.training) / each.shape[1]
            loss = share * training + (1 - share) * validation
        self.runs["hard"] += len(training)
        row["values"] = {n: np.asarray(v).tolist() for n, v in values.items()}
        self.history.append(row)
        return np.where(np.isfinite(loss), loss, np.inf)


def _clip_each(limit: float) -> optax.GradientTransformation:
    """Clip the gradient of each start by its own norm, so that one wild start does not slow the others."""

    def update(updates: Any, state: Any, params: Any = None) -> tuple[Any, Any]:
        norm = jnp.sqrt(sum(g * g for g in jax.tree.leaves(updates)) + 1e-30)
        return jax.tree.map(lambda g: g * jnp.minimum(1.0, limit / norm), updates), state

    return optax.GradientTransformation(lambda params: optax.EmptyState(), update)


def _report(
    names: tuple[str, ...], parts: Mapping[str, tuple[list[str], Judge]], params: Any
) -> dict[str, dict[str, float]]:
    """Hard-gate loss of every recording that has a label; disturbed copies, behind them, have none."""
    values = {n: np.array([float(parameters.get(params, n))]) for n in names}
    report = {}
    for part, (labels, judged) in parts.items():
        each = judged(values)[0]
        report[part] = {label: float(x) for label, x in zip(labels, each[: len(labels)], strict=True)}
    return report
