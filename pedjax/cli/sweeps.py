"""The commands `sweep` and `sweep-report`."""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import jax
from tqdm import tqdm

from pedjax import __version__, parameters
from pedjax.cli.common import configured, say, write_parameters
from pedjax.config import Config, load, resolve, resolved, site_of, sweep_design
from pedjax.errors import InputError
from pedjax.evaluation.scores import score_kind
from pedjax.output import folder, write_figure, write_json, write_table, write_toml
from pedjax.plots import sweeps as figures
from pedjax.sources import read_all
from pedjax.sweeping import store as keep
from pedjax.sweeping.campaign import Rounds, manifest_of, recordings_of, run_campaign
from pedjax.sweeping.designs import Axis
from pedjax.sweeping.engine import Job, job
from pedjax.sweeping.parquet import arrow
from pedjax.sweeping.report import Report, analyse
from pedjax.sweeping.sensitivity import Sensitivity, sensitivity
from pedjax.sweeping.store import Store
from pedjax.sweeping.team import assemble
from pedjax.sweeping.telling import describe, report_tables

_SAY_EVERY_S = 10.0


def sweep(args: argparse.Namespace) -> int:
    """Scores of a design of parameter sets, kept as they come, and the report."""
    config = configured(args)
    settings, design = sweep_design(config)
    arrow()
    recordings = read_all(config.recordings, args.format)
    work = _job(config, recordings, settings.loss)
    rounds = Rounds(settings.refine, settings.shrink, settings.count, settings.design, config.seed)
    about = {"clock": config.clock or "as read", "seed": config.seed}
    manifest = manifest_of(work, recordings, design, rounds, about)
    if jax.process_index() > 0:
        team = assemble()  # waits until the first process has made the store
        run_campaign(work, recordings, design, rounds, keep.open_store(config.out, manifest), team)
        return 0
    with keep.locked(config.out):
        store = keep.open_store(config.out, manifest)
        keep.tidy(store)
        team = assemble()
        section = {**vars(settings), "file": settings.file and str(Path(settings.file).resolve())}
        write_toml(store.path / "config.toml", resolved(config, resolve(config)[1], sweep=section))
        try:
            with _Progress(work.samples) as progress:
                run_campaign(work, recordings, design, rounds, store, team, progress=progress)
        except KeyboardInterrupt:
            say(f"interrupted; what is done is kept in {store.path}: the same command goes on from there")
            return 130
        _, columns = keep.read_store(store.path)
        _report(store, columns, store.path, config, args, work)
    return 0


def sweep_report(args: argparse.Namespace) -> int:
    """What a sweep's results say: numbers, tables, pictures."""
    place = Path(args.folder)
    store, columns = keep.read_store(place)
    config = load(place / "config.toml") if (place / "config.toml").exists() else None
    out = folder(args.out or place)
    work = _readable(store, config) if config is not None and args.gradient else None
    _report(store, columns, out, config, args, work)
    return 0


def _job(config: Config, recordings: list[Any], loss: str) -> Job:
    chosen, params = resolve(config)
    alignment = "yaw_translation" if config.alignment == "auto" else config.alignment
    return job(
        recordings, chosen, params, loss=loss, alignment=alignment, sensor=config.sensor, clock=config.clock,
        site=site_of(config),
    )  # fmt: skip


class _Progress:
    """A bar with rate and time left on a terminal, a line now and then elsewhere."""

    def __init__(self, steps: int) -> None:
        self.steps = steps
        self.bar: Any = None
        self.began: tuple[float, int] | None = None
        self.said = 0.0
        self.told = 0

    def __enter__(self) -> Callable[[int, int], None]:
        return self.show

    def show(self, done: int, total: int) -> None:
        """Called with the runs that are done and their number."""
        now = time.monotonic()
        if self.began is None:
            self.began = (now, done)
            if done:
                say(f"{done:,} of {total:,} runs are there already")
            if sys.stderr.isatty():
                self.bar = tqdm(total=total, initial=done, unit="run", dynamic_ncols=True)
            self.said = now
        since, first = self.began
        rate = (done - first) / max(now - since, 1e-9)
        if self.bar is not None:
            self.bar.n = done
            self.bar.set_postfix_str(f"{rate * self.steps / 1e6:.1f} M steps/s")
            self.bar.refresh()
        elif done > first and done != self.told and (now - self.said > _SAY_EVERY_S or done == total):
            self.said, self.told = now, done
            left = (total - done) / max(rate, 1e-9)
            say(
                f"{done:,} of {total:,} runs, {rate:.1f} runs/s, {rate * self.steps / 1e6:.1f} M filter "
                f"steps/s, {left:.0f} s left"
            )

    def __exit__(self, *error: object) -> None:
        if self.bar is not None:
            self.bar.close()


def _report(
    store: Store,
    columns: dict[str, Any],
    place: Path,
    config: Config | None,
    args: argparse.Namespace,
    work: Job | None,
) -> None:
    """Analyse the table, write all that is known of it into a folder, and say the most of it."""
    first = keep.read_design(store, 0)
    if first is None:
        raise InputError(f"{store.path}: the design is missing; run the sweep again")
    score = getattr(args, "score", None) or score_kind(store.manifest["loss"]).column
    found = analyse(columns, first.axes, store.manifest["settings"], score=score, second=args.against)
    out = folder(place / "report")
    for name, table in report_tables(found).items():
        write_table(out / f"{name}.csv", table)
    say(*describe(found))
    if not len(found.best):
        return
    best = {path: _plain(values[found.best[0]]) for path, values in found.values.items()}
    if config is not None:
        _, params = resolve(config)
        at_best = parameters.replace(params, best)
        prints = [r["fingerprint"] for r in store.manifest["recordings"]]
        heading = (
            f"best of {len(found.runs.run)} parameter sets by {score}, chosen on {len(prints)} recordings"
        )
        write_parameters(place / "best.toml", replace(config, sweep={}), at_best, prints, heading)
        if work is not None and args.gradient:
            _slopes(work, at_best, first.axes, found, out)
    if not args.no_figures and (config is None or config.figures):
        drawn = {
            "marginals": figures.marginal_figure, "pairs": figures.pair_figure,
            "effects": figures.effects_figure, "pareto": figures.pareto_figure,
        }  # fmt: skip
        for name, draw in drawn.items():
            if (name == "pareto" and found.pareto is None) or (name == "pairs" and not found.pairs):
                continue
            write_figure(out / f"{name}.png", draw(found))
    write_json(
        place / "metrics.json",
        {
            "pedjax_version": __version__, "sweep": store.identity, "score": score, "best": best,
            "best_run": int(found.runs.run[found.best[0]]),
            f"best_mean_{found.runs.unit}": float(found.runs.score[found.best[0]]),
            "runs": len(found.runs.run), "recordings": list(found.runs.recordings),
            "diverged": int(found.runs.diverged.sum()),
        },
    )  # fmt: skip
    say(f"table in {store.table}, best parameters in {place / 'best.toml'}, report in {out}")


def _plain(value: Any) -> Any:
    return value.item() if hasattr(value, "item") else value


def _slopes(work: Job, params: Any, axes: tuple[Axis, ...], found: Report, out: Path) -> None:
    """Say and write what the gradient at the best set is."""
    say("slopes at the best set, through the filter on a soft gate (--no-gradient leaves them out):")
    slopes: Sensitivity = sensitivity(work, params, axes)
    unit = score_kind(work.problem.loss).unit
    steps = {axis.path: "an e-fold" if axis.log else "1% of the range" for axis in axes}
    ordered = sorted(slopes.slope.items(), key=lambda pair: -abs(pair[1]))
    for path, slope in ordered[:12]:
        part = f"{slope / slopes.loss:+.1%} of {slopes.loss:.4g} {unit}"
        say(f"  {path}: {slope:+.3g} {unit} for {steps[path]} more ({part})")
    table: dict[str, list[Any]] = {
        "parameter": [p for p, _ in ordered],
        f"slope_{unit}": [s for _, s in ordered],
        "for": [steps[p] for p, _ in ordered],
    }
    write_table(out / "slopes.csv", table)


def _readable(store: Store, config: Config) -> Job | None:
    """The sweep's job again, where its recordings can still be read and are the same."""
    try:
        recordings = read_all(config.recordings, None)
    except InputError as error:
        say(f"no slopes at the best set: {error}")
        return None
    work = _job(config, recordings, store.manifest["loss"])
    if recordings_of(work, recordings) != store.manifest["recordings"]:
        say("no slopes at the best set: the recordings have changed since the sweep")
        return None
    return work
