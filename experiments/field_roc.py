"""Which field detector tells a quasi-static field best, and where: Ma 2018, Fig. 8, 13 and 14, as ours.

    python -m experiments.field_roc [--walks N] [--first-seed S] [--set PATH=VALUE] [--out DIR]

The three loops of an office floor and the three rounds of a mall, walks that nothing was chosen on; the true
field at the foot says which windows of four stances are quasi-static, by three definitions. Areas under the
curves, also for windows on straight and on curved paths, with 95 % intervals from drawing whole walks anew,
and the paired differences. Then what each detector finds the more a path turns, with the threshold that
finds 0.8 on the straight parts of office loops of other seeds.
"""

from __future__ import annotations

import argparse
import itertools
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from pedjax import field_roc, parameters
from pedjax.config import Config, override, resolve
from pedjax.detectors.field import FIELD_DETECTORS
from pedjax.evaluation import Banded, Labelled, compare, difference, roc
from pedjax.evaluation.resampling import draw
from pedjax.evaluation.roc import Wanted
from pedjax.field_roc import FieldWalk
from pedjax.output import folder, write_figure, write_table
from pedjax.plots import roc_curves
from pedjax.runtime import configure, default_cache
from pedjax.sources import read_labelled

SCENARIOS = ("office-loop", "mall")
DEFINITIONS = ((1.0, 2.0), (3.0, 5.0), (6.0, 10.0))
"""Largest change from stance to stance that is still quasi-static, µT and degrees."""

CHOSEN_ON = range(6)
"""Seeds of the office loops on which thresholds are chosen."""

TURNS = (0.0, 10.0, 20.0, 30.0, 45.0, 60.0, 90.0, 360.0)
"""Edges in degrees of the turn within a window."""

PARTS = ("all", "straight", "curved")


def walks_of(scenario: str, seeds: range, params: Any) -> list[FieldWalk]:
    found = []
    for seed in seeds:
        found.append(field_roc.field_walk(*read_labelled(f"{scenario}:{seed}"), params))
        print(f"  {found[-1].name}: {len(found[-1].turn)} windows", flush=True)
    return found


def area_rows(
    scenario: str,
    definition: tuple[float, float],
    given: Labelled,
    curves: dict[str, dict[str, Banded]],
) -> list[dict[str, Any]]:
    rows = []
    for part in [p for p in PARTS if p in curves]:
        label = np.concatenate([y[k] for y, k in zip(given.label, given.parts[part], strict=True)])
        for name, found in curves[part].items():
            less = difference(found, curves[part]["ma"])
            row = {"scenario": scenario, "field_uT": definition[0], "heading_deg": definition[1]}
            row |= {"part": part, "windows": len(label), "quasi_static": int(label.sum()), "detector": name}
            areas = (found.auc, found.partial, *less)
            for title, area in zip(("auc", "partial", "auc_less_ma", "partial_less_ma"), areas, strict=True):
                row |= {title: area.value, f"{title}_low": area.low, f"{title}_high": area.high}
            rows.append(row)
            print(
                f"  {part:8} {name:6} AUC {found.auc}  up to 10 % {found.partial}"
                + ("" if name == "ma" else f"  less ma's {less[0]}, {less[1]}")
            )
        print(f"  {part:8} {int(label.sum())} of {len(label)} windows are quasi-static")
    return rows


def chosen_thresholds(params: Any, walks: list[FieldWalk], definition: tuple[float, float]) -> dict[str, Any]:
    """Parameters of each detector that find 0.8 of the quasi-static windows on straight paths."""
    straight = [w.only(w.turn < field_roc.STRAIGHT) for w in walks]
    label = np.concatenate([w.label(*definition) for w in straight])
    given = field_roc.labelled(params, list(FIELD_DETECTORS), straight, *definition)
    chosen = {}
    for name, statistic in given.statistic.items():
        curve = roc(np.concatenate(statistic), label)
        point = field_roc.at_point(params, name, curve, Wanted(0.8, "detection"), straight, label)
        chosen[name] = parameters.replace(params, point.parameters)
        values = {k: v for k, v in point.parameters.items() if not isinstance(v, str)}
        print(
            f"  {name:6} {', '.join(f'{k} {v:.4g}' for k, v in values.items())}: detection "
            f"{point.p_detection:.3f}, false alarm {point.p_false_alarm:.3f}"
        )
    return chosen


def turn_rows(
    scenario: str, walks: list[FieldWalk], chosen: dict[str, Any], definition: tuple[float, float]
) -> list[dict[str, Any]]:
    """By turn of the path: detection, false alarm, and how many windows pass at all, with intervals."""
    bins = [np.digitize(np.degrees(w.turn), TURNS[1:-1]) for w in walks]
    labels = [w.label(*definition) for w in walks]
    draws = draw(len(walks))
    rows = []
    for name, params in chosen.items():
        passed = [field_roc.log_ratios(params.field, w.windows) < 0 for w in walks]
        for k, (low, high) in enumerate(itertools.pairwise(TURNS)):
            row: dict[str, Any] = {"scenario": scenario, "detector": name, "turn_from": low, "turn_to": high}
            of = {
                "detection": [y & (b == k) for y, b in zip(labels, bins, strict=True)],
                "false_alarm": [~y & (b == k) for y, b in zip(labels, bins, strict=True)],
                "passed": [b == k for b in bins],
            }
            for title, those in of.items():
                hits = np.array([(x & y).sum() for x, y in zip(passed, those, strict=True)], float)
                count = np.array([y.sum() for y in those], float)
                row |= {f"{title}_windows": int(count.sum())}
                with np.errstate(invalid="ignore"):
                    rate, drawn = hits.sum() / count.sum(), (draws @ hits) / (draws @ count)
                good = drawn[np.isfinite(drawn)]
                ends = np.percentile(good, [2.5, 97.5]) if len(good) else (np.nan, np.nan)
                row |= {title: float(rate), f"{title}_low": ends[0], f"{title}_high": ends[1]}
            rows.append(row)
    return rows


def turn_figure(rows: list[dict[str, Any]]) -> Figure:
    figure = Figure(figsize=(11, 7.5), layout="constrained")
    axes = figure.subplots(len(SCENARIOS), 2, sharey=True, squeeze=False)
    place = np.arange(len(TURNS) - 1)
    named = [f"{a:.0f}-{b:.0f}" for a, b in itertools.pairwise(TURNS[:-1])] + [f"> {TURNS[-2]:.0f}"]
    for line, scenario in zip(axes, SCENARIOS, strict=True):
        for ax, title in zip(line, ("detection", "false_alarm"), strict=True):
            for k, name in enumerate(FIELD_DETECTORS):
                own = [r for r in rows if r["scenario"] == scenario and r["detector"] == name]
                rate, low, high = (np.array([r[title + end] for r in own]) for end in ("", "_low", "_high"))
                x = place + 0.08 * (k - 2.5)
                ax.errorbar(x, rate, [rate - low, high - rate], fmt="o-", ms=3, lw=1, label=name)
            counts = [r[f"{title}_windows"] for r in own]
            ax.set_xticks(place, [f"{n}\n({c})" for n, c in zip(named, counts, strict=True)], fontsize=8)
            ax.set_title(f"{scenario}: {title.replace('_', ' ')}", fontsize=10)
            ax.set_ylim(0, 1.02)
            ax.grid(alpha=0.3)
    for ax in axes[-1]:
        ax.set_xlabel("turn within the window, degrees (windows)")
    axes[0, 0].legend(fontsize=8)
    return figure


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--walks", type=int, default=12, help="of each scenario")
    parser.add_argument("--first-seed", type=int, default=100)
    parser.add_argument("--set", metavar="PATH=VALUE", action="append", default=[], help="a parameter")
    parser.add_argument("--out", default="out")
    args = parser.parse_args()
    configure(cache=default_cache())
    out = folder(args.out)
    _, params = resolve(override(Config(system="ma2018"), args.set))
    print("walks that thresholds are chosen on")
    others = walks_of("office-loop", CHOSEN_ON, params)
    chosen = chosen_thresholds(params, others, DEFINITIONS[1])
    areas: list[dict[str, Any]] = []
    turns: list[dict[str, Any]] = []
    for scenario in SCENARIOS:
        print(f"{scenario}: walks held back")
        walks = walks_of(scenario, range(args.first_seed, args.first_seed + args.walks), params)
        for definition in DEFINITIONS:
            print(f"{scenario}, quasi-static below {definition[0]:g} µT and {definition[1]:g} degrees")
            given = field_roc.labelled(params, list(FIELD_DETECTORS), walks, *definition)
            if not np.concatenate(given.label).any():
                print("  no window is quasi-static")
                continue
            curves = compare(given)
            areas += area_rows(scenario, definition, given, curves)
            if definition == DEFINITIONS[1]:
                drawn = roc_curves({p: curves[p] for p in PARTS if p in curves})
                write_figure(out / f"field_roc_{scenario}.png", drawn)
        turns += turn_rows(scenario, walks, chosen, DEFINITIONS[1])
    for title, rows in (("areas", areas), ("turns", turns)):
        write_table(out / f"field_roc_{title}.csv", {key: [row[key] for row in rows] for key in rows[0]})
    print("by turn within the window, quasi-static below 3 µT and 5 degrees: detection / false alarm")
    for row in turns:
        print(
            f"  {row['scenario']:12} {row['detector']:6} {row['turn_from']:3.0f}-{row['turn_to']:3.0f}: "
            f"{row['detection']:.2f} [{row['detection_low']:.2f}, {row['detection_high']:.2f}] of "
            f"{row['detection_windows']}, {row['false_alarm']:.3f} of {row['false_alarm_windows']}"
        )
    write_figure(out / "field_roc_turns.png", turn_figure(turns))


if __name__ == "__main__":
    main()
