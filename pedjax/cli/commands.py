"""What each command does: read, compute, write, say."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from tqdm import tqdm

from pedjax import __version__, parameters, plots, prior
from pedjax.cli import allan, calibrate, roc, sigmas, simulate, sweeps
from pedjax.cli.common import configured, loaded, say, write_metrics, write_parameters
from pedjax.config import override, resolve, resolved, site_of, tune_settings
from pedjax.evaluation.scores import score_kind
from pedjax.identity import fingerprint
from pedjax.output import folder, write_figure, write_json, write_table, write_toml
from pedjax.recording import Recording
from pedjax.running import Track
from pedjax.running import run as run_system
from pedjax.scoring import Score, evaluate
from pedjax.sources import read_all, spelled_out
from pedjax.tuning import refuse_overlap, split
from pedjax.tuning import tune as tune_system
from pedjax.walks import distinct

_MOST_PICTURES = 12  # of single walks while tuning


def info(args: argparse.Namespace) -> int:
    """What each file holds; raw signals as pictures where --out is given."""
    names = spelled_out(args.recordings)
    recordings = read_all(names, args.format)
    out = folder(args.out) if args.out else None
    described = []
    for path, recording, stem in zip(names, recordings, _stems(recordings), strict=True):
        say(*_describe(path, recording))
        sensors = {n: {"rate_hz": s.gyroscope.rate} for n, s in recording.sensors.items()}
        described.append(
            {"path": path, "format": recording.format, "duration_s": recording.duration, "sensors": sensors,
             "findings": list(recording.findings)}
        )  # fmt: skip
        if out is not None and not args.no_figures:
            for name in recording.sensors:
                target = out / f"{stem}_{name}_signals.png"
                write_figure(target, plots.raw_signals(recording, name))
                say(f"  drawn: {target}")
    if out is not None:
        write_json(out / "info.json", {"pedjax_version": __version__, "recordings": described})
    return 0


def _describe(path: str, recording: Recording) -> list[str]:
    lines = [f"{path}: {recording.format}, {recording.duration:.1f} s"]
    for name, sensor in recording.sensors.items():
        streams = [("accelerometer", sensor.accelerometer, "m/s²"), ("gyroscope", sensor.gyroscope, "rad/s")]
        if sensor.magnetometer is not None:
            streams.append(("magnetometer", sensor.magnetometer, "µT"))
        lines.append(f"  sensor '{name}':")
        for kind, stream, unit in streams:
            size = np.linalg.norm(stream.values, axis=1)
            lines.append(
                f"    {kind:13} {len(stream.time):7d} samples at {stream.rate:.1f} Hz, "
                f"norm {np.median(size):.3g} (median), {size.max():.3g} (largest) {unit}"
            )
    if recording.landmarks is not None:
        known = np.isfinite(recording.landmarks.position).sum(axis=0)
        lines.append(
            f"  {len(recording.landmarks.time)} landmarks{_of(recording.landmarks.sensor)} "
            f"(x known at {known[0]}, y at {known[1]}, z at {known[2]})"
        )
    for truth in filter(None, (recording.truth, *recording.truths.values())):
        orientation = " with orientation" if truth.quaternion is not None else ""
        lines.append(f"  dense truth{_of(truth.sensor)}: {len(truth.time)} positions{orientation}")
    lines.append(f"  read with clock = '{recording.clock}'")
    lines += [f"  look at: {finding}" for finding in recording.findings] or ["  nothing looks wrong"]
    return lines


def _of(sensor: str | None) -> str:
    return "" if sensor is None else f" of sensor '{sensor}'"


def run(args: argparse.Namespace) -> int:
    """Tracks, errors, tables and pictures."""
    config = configured(args)
    out = folder(config.out)
    chosen, params = resolve(config)
    site = site_of(config)
    recordings = read_all(config.recordings, args.format)
    entries = []
    for path, recording, stem in zip(config.recordings, recordings, _stems(recordings), strict=True):
        track = run_system(
            recording, chosen, params, sensor=config.sensor, clock=config.clock, site=site, passes=args.passes
        )
        score = evaluate(track, recording, config.alignment)
        entry = _entry(path, recording, track, score)
        if fingerprint(recording) in config.tuned_on:
            entry["tuned_on"] = True
        entries.append(entry)
        say(_line(path, recording, track, score, entry.get("tuned_on", False)))
        write_table(out / f"{stem}_track.csv", _columns(track))
        if "gyroscope_bias" in track.estimate and track.healthy:
            prior.write(out / f"{stem}_prior.toml", prior.prior_of(track))
        if config.figures:
            picture = plots.trajectory(track, recording, score, config.alignment)
            write_figure(out / f"{stem}_trajectory.png", picture)
            for gate in list(track.gates)[:1]:
                picture = plots.gate_over_signals(track, recording, gate, config.clock)
                write_figure(out / f"{stem}_{gate}.png", picture)
    write_metrics(out, config, entries)
    write_toml(out / "config.toml", resolved(config, params))
    say(f"results in {out}")
    return 0


def _stems(recordings: Sequence[Recording]) -> list[str]:
    """Names for the files of each recording's results, each once."""
    names = [Path(r.name.replace(":", "_")).name.removesuffix(".gz").rsplit(".", 1)[0] for r in recordings]
    return distinct(names)


def _columns(track: Track) -> dict[str, Sequence[Any]]:
    columns: dict[str, Sequence[Any]] = {"time_s": track.time.tolist()}
    for name, unit in (("position", "m"), ("velocity", "m_per_s")):
        if name in track.estimate:
            values = track.estimate[name].T
            columns |= {f"{name}_{a}_{unit}": v.tolist() for a, v in zip("xyz", values, strict=True)}
    columns |= {f"{a}_rad": v.tolist() for a, v in zip(("roll", "pitch", "yaw"), track.euler.T, strict=True)}
    for k, (name, gate) in enumerate(track.gates.items()):
        columns[name] = gate.weight.tolist()
        if k == 0:
            columns[f"{name}_id"] = gate.stretches(track.time).tolist()
    if "position" in track.sigma:
        columns["sigma_horizontal_m"] = np.hypot(*track.sigma["position"].T[:2]).tolist()
    if "attitude" in track.sigma:
        columns["sigma_yaw_rad"] = track.sigma["attitude"][:, 2].tolist()
    return columns


def _notes(recording: Recording, track: Track, score: Score | None) -> list[str]:
    """All that is to be looked at."""
    return [*recording.findings, *track.warnings, *(score.warnings if score is not None else ())]


def _entry(path: str, recording: Recording, track: Track, score: Score | None) -> dict[str, Any]:
    entry: dict[str, Any] = {
        "path": str(path),
        "distance_m": track.distance,
        "duration_s": float(track.time[-1] - track.time[0]),
        "healthy": track.healthy,
        **{f"{name}_fraction": float(gate.open.mean()) for name, gate in track.gates.items()},
    }
    if score is not None:
        entry["landmarks"] = {k: v for k, v in score.as_dict().items() if k != "warnings"}
    if notes := _notes(recording, track, score):
        entry["warnings"] = notes
    return entry


def _line(path: str, recording: Recording, track: Track, score: Score | None, tuned_on: bool = False) -> str:
    text = f"{path}: {track.distance:.1f} m in {track.time[-1] - track.time[0]:.1f} s"
    if score is not None and score.rms_2d_m is not None:
        text += (
            f", RMS {score.rms_2d_m:.3f} m, final {score.final_2d_m:.3f} m "
            f"({score.percent_of_distance or 0:.2f} % of the distance), {score.count} points, "
            f"{score.alignment}"
        )
    if tuned_on:
        text += " [tuned on this recording]"
    if score is not None and score.rms_2d_m is None and score.heading_rms_deg is not None:
        text += f", heading RMS {score.heading_rms_deg:.2f} deg"
    if not track.healthy:
        text += " [NOT HEALTHY]"
    for note in _notes(recording, track, score):
        text += f"\n  look at: {note}"
    return text


def tune(args: argparse.Namespace) -> int:
    """Tuned parameters, errors before and after, history, pictures."""
    config = configured(args)
    settings = tune_settings(config)
    chosen, params = resolve(config)
    site = site_of(config)
    unit = score_kind(settings.loss).unit
    out = folder(config.out)
    recordings = read_all(config.recordings, args.format)
    held = read_all(config.held_back, args.format)
    paths, held_paths = list(config.recordings), list(config.held_back)
    if config.split is not None:
        first, second = split(recordings, config.split, config.seed)
        held_paths += [paths[i] for i in second]
        held += [recordings[i] for i in second]
        paths, recordings = [paths[i] for i in first], [recordings[i] for i in first]
    refuse_overlap(config.tuned_on, held)  # the given parameters may have been tuned on them already
    copies = settings.augment.copies
    beside = f" and {copies} disturbed copies of each" if copies else ""
    with tqdm(total=settings.iterations, unit="step", disable=not sys.stderr.isatty()) as bar:

        def progress(iteration: int, total: int, best: float) -> None:
            bar.n = iteration
            bar.set_postfix_str(f"best {best:.3f} {unit}")
            bar.refresh()
            if not sys.stderr.isatty():
                say(f"step {iteration} of {total}: best {best:.4f} {unit}")

        tuned = tune_system(
            recordings, settings, chosen, params,
            held_back=held, sensor=config.sensor, clock=config.clock, site=site, progress=progress,
        )  # fmt: skip
    write_parameters(
        out / "tuned.toml",
        config,
        tuned.params,
        tuned.fingerprints,
        f"tuned by pedjax {__version__} on {len(recordings)} recordings{beside}: {', '.join(settings.names)}",
    )
    write_toml(out / "config.toml", resolved(config, params, tune=_tune_section(settings)))
    entries = []
    parts = [("tuned_on", p, r) for p, r in zip(paths, recordings, strict=True)]
    parts += [("held_back", p, r) for p, r in zip(held_paths, held, strict=True)]
    for (part, path, recording), stem in zip(parts, _stems([*recordings, *held]), strict=True):
        again = partial(run_system, recording, chosen, sensor=config.sensor, clock=config.clock, site=site)
        track = again(tuned.params)
        score = evaluate(track, recording, config.alignment)
        entries.append({**_entry(path, recording, track, score), "part": part})
        if config.figures and len(entries) <= _MOST_PICTURES:
            picture = plots.trajectory(track, recording, score, config.alignment, ("before", again(params)))
            write_figure(out / f"{stem}_trajectory.png", picture)
    before, after = _summary(tuned.before, unit), _summary(tuned.after, unit)
    mean = f"mean_{unit}"
    write_metrics(
        out, config, entries, loss=settings.loss, before=before, after=after, filter_runs=tuned.runs,
        warnings=list(tuned.warnings),
        tuned={n: {"from": float(parameters.get(params, n)), "to": v} for n, v in tuned.values.items()},
    )  # fmt: skip
    write_table(out / "history.csv", _history(tuned.history, unit))
    if config.figures:
        write_figure(out / "tuning.png", plots.tuning_history(tuned))
    for name, value in tuned.values.items():
        own = parameters.specs(params)[name].unit
        say(f"  {name}: {float(parameters.get(params, name)):.4g} to {value:.4g} {own}")
    for group in before:
        say(
            f"{group.replace('_', ' ')} ({before[group]['count']} recordings): mean {settings.loss} "
            f"{_in(before[group][mean], unit)} before, {_in(after[group][mean], unit)} after"
        )
    for doubt in tuned.warnings:
        say(f"  look at: {doubt}")
    say(f"filter runs: {tuned.runs['gradients']} gradients, {tuned.runs['hard']} hard", f"results in {out}")
    return 0


def _in(value: float | None, unit: str) -> str:
    return "diverged" if value is None or not np.isfinite(value) else f"{value:.4f} {unit}"


def _tune_section(settings: Any) -> dict[str, Any]:
    return {k: list(v) if isinstance(v, tuple) else v for k, v in asdict(settings).items()}


def _summary(report: dict[str, dict[str, float]], unit: str) -> dict[str, Any]:
    return {
        group: {
            "count": len(each),
            f"mean_{unit}": float(np.mean(list(each.values()))),
            f"median_{unit}": float(np.median(list(each.values()))),
            f"worst_{unit}": float(np.max(list(each.values()))),
            f"each_{unit}": each,
        }
        for group, each in report.items()
    }


def _history(history: list[dict[str, Any]], unit: str) -> dict[str, list[Any]]:
    rows: dict[str, list[Any]] = {}
    for row in history:
        for start, training in enumerate(row["training"]):
            line = {"iteration": row["iteration"], "start": start, f"training_{unit}": training}
            if "validation" in row:
                line[f"validation_{unit}"] = row["validation"][start]
            line |= {name: v[start] for name, v in row["values"].items()}
            for key, value in line.items():
                rows.setdefault(key, []).append(value)
    return rows


def show_parameters(args: argparse.Namespace) -> int:
    """The parameters of a system as a table."""
    _, params = resolve(override(loaded(args), args.set))
    say(parameters.table(params))
    return 0


COMMANDS = {
    "info": info,
    "run": run,
    "tune": tune,
    "simulate": simulate.run,
    "allan": allan.allan,
    "calibrate": calibrate.calibrate,
    "sweep": sweeps.sweep,
    "sweep-report": sweeps.sweep_report,
    "roc": roc.roc,
    "sigmas": sigmas.sigmas,
    "parameters": show_parameters,
}
