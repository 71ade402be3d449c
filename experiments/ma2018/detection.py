"""Which field detector tells a quasi-static field best, and where: Ma 2018, Fig. 8, 13 and 14, as ours.

    python -m experiments.ma2018 detection
    python -m experiments.ma2018.detection [--walks N] [--first-seed S] [--set PATH=VALUE] [--out DIR]

The three loops of an office floor and the three rounds of three malls, walks that nothing was chosen on; the
true field at the foot says which windows of four stances are quasi-static, by three definitions. Areas under
the curves, also for windows on straight and on curved paths, with 95 % intervals, the paired differences, and
the knee (where detection leads false alarm most). Then what each detector finds the more a path turns, with
the threshold that finds 0.8 on the straight parts of office loops of other seeds; and how that threshold
depends on what is called quasi-static.
"""

from __future__ import annotations

import argparse
import itertools
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from experiments.table import Row, row
from pedjax import parameters
from pedjax.config import Config, override, resolve
from pedjax.detection import Banded, Labelled, Wanted, compare, difference, roc
from pedjax.detection import field as judging
from pedjax.detection.bands import draw, rate
from pedjax.detection.field import FieldWalk
from pedjax.detectors.field import FIELD_DETECTORS
from pedjax.output import folder, write_figure, write_table
from pedjax.plots import roc_curves
from pedjax.runtime import configure, default_cache
from pedjax.sources import read_labelled

SYSTEM = "ma2018"
SCENARIOS = ("office-loop", "mall-gentle", "mall-between", "mall")
WALKS = 12
"""Most of each scenario."""

DEFINITIONS = ((1.0, 2.0), (3.0, 5.0), (6.0, 10.0))
"""Largest change from stance to stance that is still quasi-static, µT and degrees."""

CHOSEN_ON = range(6)
"""Seeds of the office loops on which thresholds are chosen."""

TURNS = (0.0, 10.0, 20.0, 30.0, 45.0, 60.0, 90.0, 360.0)
"""Edges in degrees of the turn within a window."""

LOOSE = (20.0, 30.0)
"""What must count as quasi-static for the published threshold to find 0.8."""

PARTS = ("all", "straight", "curved")


def walks_of(scenario: str, seeds: range, params: Any) -> list[FieldWalk]:
    found = []
    for seed in seeds:
        found.append(judging.field_walk(*read_labelled(f"{scenario}:{seed}"), SYSTEM, params))
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
        positive, count = given.counts(part)
        for name, found in curves[part].items():
            less = difference(found, curves[part]["ma"])
            row = {"scenario": scenario, "field_uT": definition[0], "heading_deg": definition[1]}
            row |= {"part": part, "windows": count, "quasi_static": positive, "detector": name}
            row |= knee(found)
            areas = (found.auc, found.partial, *less)
            for title, area in zip(("auc", "partial", "auc_less_ma", "partial_less_ma"), areas, strict=True):
                row |= area.columns(title)
            rows.append(row)
            print(
                f"  {part:8} {name:6} AUC {found.auc}  up to 10 % {found.partial}"
                + ("" if name == "ma" else f"  less ma's {less[0]}, {less[1]}")
            )
        print(f"  {part:8} {positive} of {count} windows are quasi-static")
    return rows


def knee(found: Banded) -> dict[str, float]:
    """Where detection leads false alarm most: threshold, and both."""
    at = int(np.argmax(found.roc.p_detection - found.roc.p_false_alarm))
    names = ("threshold", "p_detection", "p_false_alarm")
    return {f"knee_{name}": float(getattr(found.roc, name)[at]) for name in names}


def label_rows(params: Any, walks: list[FieldWalk]) -> list[Row]:
    """The threshold that finds 0.8 on straight paths, by what is called quasi-static."""
    straight = [w.only(w.turn < judging.STRAIGHT) for w in walks]
    rows = []
    for definition in (*DEFINITIONS, LOOSE):
        label = np.concatenate([w.label(*definition) for w in straight])
        if not label.any() or label.all():
            continue
        given = judging.labelled(params, ["iqsf", "ma"], straight, *definition)
        told = []
        for name, statistic in given.statistic.items():
            threshold = roc(np.concatenate(statistic), label).at(Wanted(0.8, "detection"))
            told.append(f"{name} {threshold:.3g}")
        what = f"threshold for 0.8, quasi-static below {definition[0]:g} µT, {definition[1]:g} deg"
        rows.append(row("F8", what, "170", f"{', '.join(told)} ({label.mean():.1%} of windows)", None))
    return rows


def chosen_thresholds(params: Any, walks: list[FieldWalk], definition: tuple[float, float]) -> dict[str, Any]:
    """Parameters of each detector that find 0.8 of the quasi-static windows on straight paths."""
    straight = [w.only(w.turn < judging.STRAIGHT) for w in walks]
    label = np.concatenate([w.label(*definition) for w in straight])
    given = judging.labelled(params, list(FIELD_DETECTORS), straight, *definition)
    chosen = {}
    for name, statistic in given.statistic.items():
        curve = roc(np.concatenate(statistic), label)
        point = judging.at_point(params, name, curve, Wanted(0.8, "detection"), straight, label)
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
        passed = [judging.log_ratios(params.field, w.windows) < 0 for w in walks]
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
                row |= rate(hits, count, draws).columns(title)
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
                found, low, high = (np.array([r[title + end] for r in own]) for end in ("", "_low", "_high"))
                x = place + 0.08 * (k - 2.5)
                ax.errorbar(x, found, [found - low, high - found], fmt="o-", ms=3, lw=1, label=name)
            counts = [r[f"{title}_windows"] for r in own]
            ax.set_xticks(place, [f"{n}\n({c})" for n, c in zip(named, counts, strict=True)], fontsize=8)
            ax.set_title(f"{scenario}: {title.replace('_', ' ')}", fontsize=10)
            ax.set_ylim(0, 1.02)
            ax.grid(alpha=0.3)
    for ax in axes[-1]:
        ax.set_xlabel("turn within the window, degrees (windows)")
    axes[0, 0].legend(fontsize=8)
    return figure


def table_rows(areas: list[dict[str, Any]], turns: list[dict[str, Any]]) -> list[Row]:
    """Figs. 8, 13 and 14: the order of the detectors, and what is left of them on curves."""
    found = []
    for scenario in SCENARIOS:
        of = {
            (line["part"], line["detector"]): line
            for line in areas
            if line["scenario"] == scenario and line["field_uT"] == DEFINITIONS[1][0]
        }
        for part, published in (("straight", "Ma, iQSF above QSF"), ("curved", "Ma above QSF above iQSF")):
            if (part, "ma") not in of:
                continue
            qsf, iqsf, ma, vector = (of[part, n] for n in ("qsf", "iqsf", "ma", "vector"))
            if part == "straight":
                met = min(ma["auc"], iqsf["auc"]) > qsf["auc"]
            else:
                met = ma["auc"] > qsf["auc"] > iqsf["auc"]
            knees = [f"{n['knee_p_detection']:.2f}/{n['knee_p_false_alarm']:.2f}" for n in (qsf, iqsf, ma)]
            told = ", ".join(
                f"{n['detector']} {n['auc']:.3f} (knee {at})"
                for n, at in zip((qsf, iqsf, ma), knees, strict=True)
            )
            found.append(row("F8", f"{scenario}, {part}: area under ROC", published, told, bool(met)))
            found.append(
                row(
                    "F8", f"{scenario}, {part}: ours above Ma, bands apart", "-",
                    f"{vector['auc']:.3f} [{vector['auc_low']:.3f}, {vector['auc_high']:.3f}] / "
                    f"{ma['auc']:.3f} [{ma['auc_low']:.3f}, {ma['auc_high']:.3f}]",
                    bool(vector["auc_low"] > ma["auc_high"]),
                )
            )  # fmt: skip
        sharp = {n: _on_curves(turns, scenario, n) for n in ("qsf", "iqsf", "ma", "vector")}
        found.append(
            row(
                "F8", f"{scenario}, 20 deg a window and more: found/false", "Ma above QSF above iQSF",
                ", ".join(f"{n} {x['detection']:.2f}/{x['false_alarm']:.2f}" for n, x in sharp.items()),
                _gain(sharp["ma"]) > _gain(sharp["qsf"]) > _gain(sharp["iqsf"]),
            )
        )  # fmt: skip
        iqsf, ma = sharp["iqsf"]["passed"], sharp["ma"]["passed"]
        found.append(
            row(
                "F13,14", f"{scenario}, 20 deg a window and more: passed", "iQSF sparse, below 0.3 of Ma",
                f"iQSF {iqsf:.3f}, Ma {ma:.3f}", bool(iqsf < 0.3 * ma),
            )
        )  # fmt: skip
    return found


def _on_curves(turns: list[dict[str, Any]], scenario: str, detector: str) -> dict[str, float]:
    """Rates in all windows that turn by 20 degrees and more, with the threshold from straight paths."""
    own = [
        x for x in turns if (x["scenario"], x["detector"]) == (scenario, detector) and x["turn_from"] >= 20
    ]
    found = {}
    for title in ("detection", "false_alarm", "passed"):
        some = [x for x in own if x[f"{title}_windows"]]
        count = [x[f"{title}_windows"] for x in some]
        found[title] = float(np.average([x[title] for x in some], weights=count)) if some else np.nan
    return found


def _gain(rates: dict[str, float]) -> float:
    return rates["detection"] - rates["false_alarm"]


def run(seeds: range, out: Path, sets: Sequence[str] = ()) -> list[Row]:
    """Curves, areas, and detection by turn, all written to `out`; the rows of the table."""
    _, params = resolve(override(Config(system=SYSTEM), list(sets)))
    print("walks that thresholds are chosen on")
    others = walks_of("office-loop", CHOSEN_ON, params)
    chosen = chosen_thresholds(params, others, DEFINITIONS[1])
    by_label = label_rows(params, others)
    areas: list[dict[str, Any]] = []
    turns: list[dict[str, Any]] = []
    for scenario in SCENARIOS:
        print(f"{scenario}: walks held back")
        walks = walks_of(scenario, seeds[:WALKS], params)
        for definition in DEFINITIONS:
            print(f"{scenario}, quasi-static below {definition[0]:g} µT and {definition[1]:g} degrees")
            given = judging.labelled(params, list(FIELD_DETECTORS), walks, *definition)
            if not np.concatenate(given.label).any():
                print("  no window is quasi-static")
                continue
            curves = compare(given)
            areas += area_rows(scenario, definition, given, curves)
            if definition == DEFINITIONS[1]:
                drawn = roc_curves({p: curves[p] for p in PARTS if p in curves})
                write_figure(out / f"figure_8_{scenario}.png", drawn)
        turns += turn_rows(scenario, walks, chosen, DEFINITIONS[1])
    for title, rows in (("areas", areas), ("turns", turns)):
        write_table(out / f"detection_{title}.csv", {key: [line[key] for line in rows] for key in rows[0]})
    print("by turn within the window, quasi-static below 3 µT and 5 degrees: detection / false alarm")
    for line in turns:
        print(
            f"  {line['scenario']:12} {line['detector']:6} {line['turn_from']:3.0f}-{line['turn_to']:3.0f}: "
            f"{line['detection']:.2f} [{line['detection_low']:.2f}, {line['detection_high']:.2f}] of "
            f"{line['detection_windows']}, {line['false_alarm']:.3f} of {line['false_alarm_windows']}"
        )
    write_figure(out / "figure_13_14.png", turn_figure(turns))
    return [*by_label, *table_rows(areas, turns)]


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--walks", type=int, default=WALKS, help="of each scenario")
    parser.add_argument("--first-seed", type=int, default=400)
    parser.add_argument("--set", metavar="PATH=VALUE", action="append", default=[], help="a parameter")
    parser.add_argument("--out", type=Path, default=Path("out/ma2018_detection"))
    args = parser.parse_args()
    configure(cache=default_cache())
    run(range(args.first_seed, args.first_seed + args.walks), folder(args.out), args.set)


if __name__ == "__main__":
    main()
