"""The command `roc`: detectors of stance, of a quasi-static field or of straight walking against what is
true."""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from itertools import combinations
from typing import Any

from pedjax import __version__, parameters
from pedjax.cli.common import configured, loaded, looking, say, write_metrics, write_parameters
from pedjax.config import Config, resolve
from pedjax.detection import (
    Banded,
    Interval,
    Judged,
    Labelled,
    Reached,
    Wanted,
    difference,
    judge_field,
    judge_stance,
    judge_straight,
    looks_at_field,
)
from pedjax.detection.bands import FEWEST
from pedjax.detectors.field import FIELD_DETECTORS
from pedjax.detectors.stance import DETECTORS
from pedjax.detectors.straight import STRAIGHT_DETECTORS
from pedjax.errors import InputError, suggest
from pedjax.identity import fingerprint
from pedjax.output import folder, write_figure, write_table
from pedjax.sources import read_all, read_labelled
from pedjax.walks import sensor_names

KINDS: dict[str, Mapping[str, Any]] = {
    "stance": DETECTORS, "field": FIELD_DETECTORS, "straight": STRAIGHT_DETECTORS,
}  # fmt: skip
DRAWN = ("all", "straight", "curved")
"""The parts whose curves are drawn and written."""


def add_parser(commands: Any, both: list[argparse.ArgumentParser]) -> None:
    """`pedjax roc` and its options."""
    parser = commands.add_parser(
        "roc", parents=both, help="ROC of detectors of stance, field or straight walking against what is true"
    )
    parser.add_argument("--kind", choices=tuple(KINDS), help="of detectors (default: that of those named)")
    parser.add_argument("--detectors", nargs="+", metavar="NAME", help="default: all of their kind")
    point = parser.add_mutually_exclusive_group()
    point.add_argument(
        "--false-alarm", type=float, default=0.05, metavar="P", help="operating point (default: 0.05)"
    )
    point.add_argument("--detection", type=float, metavar="P", help="operating point, by what it detects")
    parser.add_argument(
        "--partial", type=float, default=0.1, metavar="P",
        help="false alarms up to which the partial area is taken (default: 0.1)",
    )  # fmt: skip
    parser.add_argument(
        "--still-below", type=float, default=0.1, metavar="M/S", help="speed below which the foot is still"
    )
    parser.add_argument(
        "--same-field", type=float, default=3.0, metavar="UT",
        help="change from stance to stance below which the field is quasi-static (default: 3)",
    )  # fmt: skip
    parser.add_argument(
        "--same-heading", type=float, default=5.0, metavar="DEG",
        help="the same of its horizontal direction (default: 5)",
    )  # fmt: skip
    parser.add_argument(
        "--bent-below", type=float, default=5.0, metavar="DEG",
        help="bend of the true path in a window of strides below which it is straight (default: 5)",
    )  # fmt: skip


def roc(args: argparse.Namespace) -> int:
    """Curves with bands, areas with intervals, and each detector at the wanted point as a config."""
    _, params = resolve(loaded(args))  # with the plugins, which may bring detectors and systems
    kind, names = _kind(args)
    if kind == "field" and args.system is None and not looks_at_field(params):
        args.system = looking()[0]
    config = configured(args)
    wanted = _wanted(args)
    out = folder(config.out)
    judged = {"stance": _stance, "field": _field, "straight": _straight}[kind](args, config, names)
    curves = judged.curves(seed=config.seed, upto=args.partial)
    points = {}
    for name, found in curves["all"].items():
        reached = judged.at_point(name, found.roc, wanted)
        points[name] = _point(found, reached, wanted, args.partial)
        points[name]["parts"] = {part: _areas(each[name]) for part, each in curves.items()}
        _write_point(out / f"roc_{name}.toml", config, judged, points[name])
        write_table(out / f"roc_{name}.csv", _curve_table({p: curves[p][name] for p in DRAWN if p in curves}))
        say(_line(name, found, points[name], args.partial))
        split = [part for part in curves if part in DRAWN[1:]]
        say(*(_part_line(part, curves[part][name], judged.given) for part in split))
    pairs = {
        f"{a} - {b}": dict(zip(("auc", "partial_auc"), map(_plain, difference(x, y)), strict=True))
        for (a, x), (b, y) in combinations(curves["all"].items(), 2)
    }
    shown = [found for part in DRAWN if part in curves for found in curves[part].values()]
    if any(found.walks < FEWEST for found in shown):
        say(f"[?]: intervals and bands need at least {FEWEST} recordings with windows of both labels")
    write_table(out / "roc.csv", _area_table(curves, judged.given))
    told = zip(config.recordings, judged.entries, strict=True)
    entries = [{"path": str(path), **entry} for path, entry in told]
    write_metrics(out, config, entries, kind=kind, roc=points, differences=pairs, **judged.definition)
    if config.figures:
        from pedjax import plots

        write_figure(out / "roc.png", plots.roc_curves({p: curves[p] for p in DRAWN if p in curves}))
    say(f"results in {out}")
    return 0


def _kind(args: argparse.Namespace) -> tuple[str, list[str]]:
    named = args.detectors or []
    known = KINDS[args.kind] if args.kind else [name for each in KINDS.values() for name in each]
    for name in named:
        if name not in known:
            raise InputError(f"detector '{name}' is unknown{suggest(name, known)}")
    kinds = {kind for kind, known in KINDS.items() if set(named) & set(known)} or {args.kind or "stance"}
    if len(kinds) > 1:
        raise InputError(
            f"--detectors {' '.join(named)}: they judge {' and '.join(sorted(kinds))}; name those of one kind"
        )
    kind = kinds.pop()
    return kind, list(dict.fromkeys(named)) or list(KINDS[kind])


def _wanted(args: argparse.Namespace) -> Wanted:
    for option in ("false_alarm", "detection", "partial"):
        value = getattr(args, option)
        if value is not None and not 0 < value < 1:
            raise InputError(f"--{option.replace('_', '-')} {value:g} must lie between 0 and 1")
    for option, unit in (
        ("still_below", "speed in m/s"),
        ("same_field", "change in µT"),
        ("same_heading", "angle in degrees"),
        ("bent_below", "angle in degrees"),
    ):
        if not getattr(args, option) > 0:
            value = getattr(args, option)
            raise InputError(f"--{option.replace('_', '-')} {value:g} must be a positive {unit}")
    return Wanted(args.false_alarm) if args.detection is None else Wanted(args.detection, "detection")


def _stance(args: argparse.Namespace, config: Config, names: list[str]) -> Judged:
    system, params = resolve(config)
    sensor = next(iter(sensor_names(system.needs, config.sensor).values()))
    recordings = read_all(config.recordings, args.format)
    return judge_stance(
        params, recordings, names, sensor=sensor, clock=config.clock, still_below=args.still_below
    )


def _field(args: argparse.Namespace, config: Config, names: list[str]) -> Judged:
    system, params = resolve(config)
    if not looks_at_field(params):
        those = ", ".join(looking())
        raise InputError(
            f"the system '{system.name}' does not look at the field; choose another --system ({those})"
        )
    sensor = next(iter(sensor_names(system.needs, config.sensor).values()))
    made = (read_labelled(path, args.format, sensor) for path in config.recordings)
    return judge_field(
        system,
        params,
        made,
        names,
        sensor=sensor,
        clock=config.clock,
        same_field=args.same_field,
        same_heading=args.same_heading,
    )


def _straight(args: argparse.Namespace, config: Config, names: list[str]) -> Judged:
    system, params = resolve(config)
    sensor = next(iter(sensor_names(system.needs, config.sensor).values()))
    made = (read_labelled(path, args.format, sensor) for path in config.recordings)
    return judge_straight(
        system, params, made, names, sensor=sensor, clock=config.clock, bent_below=args.bent_below
    )


def _plain(value: Interval) -> dict[str, float]:
    return value._asdict()


def _areas(found: Banded) -> dict[str, Any]:
    return {"auc": _plain(found.auc), "partial_auc": _plain(found.partial)}


def _point(found: Banded, reached: Reached, wanted: Wanted, upto: float) -> dict[str, Any]:
    return {
        "auc": found.auc.value,
        "auc_interval": [found.auc.low, found.auc.high],
        "partial_auc": found.partial.value,
        "partial_auc_interval": [found.partial.low, found.partial.high],
        "partial_upto": upto,
        wanted.keep: wanted.probability,
        "threshold": found.roc.at(wanted),
        "parameters": reached.parameters,
        "p_detection": reached.p_detection,
        "p_false_alarm": reached.p_false_alarm,
    }


def _write_point(path: Any, config: Config, judged: Judged, point: dict[str, Any]) -> None:
    write_parameters(
        path,
        config,
        parameters.replace(judged.params, point["parameters"]),
        [fingerprint(r) for r in judged.recordings],
        f"chosen by pedjax {__version__} from the ROC of {len(judged.recordings)} recordings: detection "
        f"{point['p_detection']:.3f}, false alarm {point['p_false_alarm']:.3f}",
    )


def _curve_table(curves: dict[str, Banded]) -> dict[str, list[Any]]:
    columns = ("threshold", "p_false_alarm", "p_detection", "low", "high")
    titles = ("threshold", "p_false_alarm", "p_detection", "p_detection_low", "p_detection_high")
    table: dict[str, list[Any]] = {"part": [p for p, x in curves.items() for _ in x.band.threshold]}
    for column, title in zip(columns, titles, strict=True):
        table[title] = [v for x in curves.values() for v in getattr(x.band, column).tolist()]
    return table


def _area_table(curves: dict[str, dict[str, Banded]], given: Labelled) -> dict[str, list[Any]]:
    rows: list[dict[str, Any]] = []
    for part, each in curves.items():
        yes, count = given.counts(part)
        for name, found in each.items():
            row = {"part": part, "detector": name, "windows": count, "positive": yes}
            rows.append(row | found.auc.columns("auc") | found.partial.columns("partial_auc"))
    return {key: [row[key] for row in rows] for key in rows[0]}


def _line(name: str, found: Banded, point: dict[str, Any], upto: float) -> str:
    chosen = ", ".join(f"{k} {v:.4g}" for k, v in point["parameters"].items() if not isinstance(v, str))
    return (
        f"{name:6} AUC {found.auc}, up to {upto:.0%} false alarm {found.partial}; detection "
        f"{point['p_detection']:.3f} and false alarm {point['p_false_alarm']:.3f} with {chosen}"
    )


def _part_line(part: str, found: Banded, given: Labelled) -> str:
    yes, all_of_it = given.counts(part)
    return f"  {part:8} AUC {found.auc}, partial {found.partial}; {yes} of {all_of_it} windows"
