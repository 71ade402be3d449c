"""Tables, figures and lines of what the experiments on the biases found."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.figure import Figure

from experiments.munoz_diaz.emulated import BIAS
from experiments.table import Row, row
from pedjax.output import write_figure, write_table

if TYPE_CHECKING:
    from experiments.munoz_diaz.biases import Found, Key

COLOURS = ("C0", "C3", "C2")
SURE = {"north_pole": 19.0, "equator": 9.5, "munich": 10.3}
"""min, by the information that the fields hold."""
REACHED = {"north_pole": 29, "equator": 10, "munich": 15}
"""min, Fig. 9."""
LETTERS = {"north_pole": "a", "equator": "b", "munich": "c"}
ONES, TENTHS = "0.57", "0.039"
FASTER = 3.0


def band(values: Any, digits: int = 2) -> str:
    """Median and 10 to 90 %; a dash for what never comes."""
    found = np.quantile(np.asarray(values, float), [0.5, 0.1, 0.9], method="nearest")
    middle, low, high = (f"{x:.{digits}f}" if np.isfinite(x) else "-" for x in found)
    return f"{middle} ({low} to {high})"


def write(found: Mapping[Key, Found], out: Path) -> None:
    lines = []
    for (scene, variant, spread), each in found.items():
        line: dict[str, Any] = {"scene": scene, "variant": variant, "first_sigma_deg_s": spread}
        for name in ("sure", "reach", "settle"):
            values = getattr(each.axes[2], name)
            low, middle, high = np.quantile(values, [0.1, 0.5, 0.9], method="nearest")
            line |= {f"z_{name}_min": middle, f"z_{name}_p10": low, f"z_{name}_p90": high}
        for letter, axis, truth in zip("xyz", each.axes, np.degrees(BIAS), strict=True):
            low, middle, high = np.quantile(axis.end, [0.1, 0.5, 0.9])
            line |= {f"{letter}_end": middle, f"{letter}_p10": low, f"{letter}_p90": high}
            line |= {f"{letter}_nees": axis.nees.mean(), f"{letter}_rms": rms(axis.end - truth)}
        sigma = each.told.sigma[:, 2].mean(axis=-1)
        line |= {"z_sigma_left": sigma[-1] / np.radians(float(spread)), "seeds": each.yaw.shape[1]}
        most = np.abs(each.yaw).max(axis=0)
        line |= {"yaw_end_deg": np.median(each.yaw[-1]), "yaw_most_deg": np.median(most)}
        line |= {f"open_{name}": w.mean() for name, w in each.told.weight.items()}
        line["faults"] = int((each.told.status[-1] > 0).sum())
        lines.append(line)
    keys = list(dict.fromkeys(key for line in lines for key in line))
    write_table(out / "biases.csv", {key: [line.get(key, "") for line in lines] for key in keys})
    figures = {
        "fig8": [("munich", "gravity", s) for s in (ONES, TENTHS)],
        "fig9": [(p, "published", s) for s in (ONES, TENTHS) for p in REACHED],
        "fig9_state": [(p, "state", s) for s in (ONES, TENTHS) for p in REACHED],
        "fig10": [("same line", v, ONES) for v in _COMPARED],
        "fig10_other": [("other lines", v, ONES) for v in _COMPARED],
    }
    for name, keys_ in figures.items():
        write_figure(out / f"{name}.png", _traces([(k, found[k]) for k in keys_]))
    write_figure(out / "fig11.png", _yaws([(name, found[k]) for name, k in _YAWS.items()]))


_COMPARED = (
    "published",
    "published, detector",
    "anchored, detector",
    "moving average, detector",
    "state, deviation",
    "state, street's deviation, detector",
)
_YAWS: dict[str, Key] = {
    "no magnetic update": ("munich", "gravity", TENTHS),
    "Munich": ("munich", "published", ONES),
    "Equator": ("equator", "published", ONES),
    "perturbed, detector": ("same line", "published, detector", ONES),
    "perturbed, state": ("same line", "state, street's deviation, detector", ONES),
}


def rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values**2)))


def _traces(found: list[tuple[Key, Found]]) -> Figure:
    across = 3 if len(found) > 2 else 2
    down = -(-len(found) // across)
    figure = Figure(figsize=(4.4 * across, 3.2 * down), layout="constrained")
    for ax, (key, each) in zip(np.ravel(figure.subplots(down, across)), found, strict=True):
        minutes = each.told.time / 60
        for axis, colour in enumerate(COLOURS):
            bias = np.degrees(each.told.bias[:, axis])
            low, middle, high = np.quantile(bias, [0.1, 0.5, 0.9], axis=-1)
            sigma = np.degrees(each.told.sigma[:, axis]).mean(axis=-1)
            ax.fill_between(minutes, low, high, color=colour, alpha=0.25, lw=0)
            ax.plot(minutes, middle, color=colour, lw=1.1, label="xyz"[axis])
            for side in (-1, 1):
                ax.plot(minutes, middle + side * sigma, color=colour, lw=0.4)
            ax.axhline(np.degrees(BIAS[axis]), color=colour, lw=0.6, ls=":")
        ax.set_ylim(-0.3, 0.3)
        ax.set_title(f"{key[0]}: {key[1]}, {key[2]} deg/s", fontsize=8)
        ax.set_xlabel("time (min)")
        ax.set_ylabel("bias (deg/s)")
        ax.grid(alpha=0.3)
        ax.legend(fontsize=7, loc="upper right")
    return figure


def _yaws(found: list[tuple[str, Found]]) -> Figure:
    figure = Figure(figsize=(13, 3), layout="constrained")
    for ax, (name, each) in zip(figure.subplots(1, len(found)), found, strict=True):
        minutes = each.told.time / 60
        low, middle, high = np.quantile(each.yaw, [0.1, 0.5, 0.9], axis=-1)
        ax.fill_between(minutes, low, high, alpha=0.3, lw=0)
        ax.plot(minutes, middle, lw=1)
        ax.set_title(name, fontsize=9)
        ax.set_xlabel("time (min)")
        ax.grid(alpha=0.3)
    figure.axes[0].set_ylabel("error of yaw (deg)")
    return figure


def rows(found: Mapping[Key, Found]) -> list[Row]:
    return [*_gravity(found), *_homogeneous(found), *_along(found), *_perturbed(found), *_yaw(found)]


def _gravity(found: Mapping[Key, Found]) -> list[Row]:
    made = []
    for spread in (ONES, TENTHS):
        each = found["munich", "gravity", spread]
        x, y, z = each.axes
        left = float(each.told.sigma[-1, 2].mean()) / np.radians(float(spread))
        name = f"gravity only, first sigma {spread}"
        y_good, x_good = abs(np.median(y.end) - 0.1) < 0.01, -0.1 < np.median(x.end) < 0
        never = bool(np.isinf(z.settle).mean() > 0.5)
        made += [
            row("DI-F8", f"{name}: b_y, deg/s", "converges to 0.1", band(y.end, 3), bool(y_good)),
            row("DI-F8", f"{name}: b_x, deg/s", "right sign, short of -0.1", band(x.end, 3), bool(x_good)),
            row("DI-F8", f"{name}: b_z, deg/s", "does not converge to -0.1", band(z.end, 3), never),
            row(
                "DI-F8",
                f"{name}: sigma of z, end to first",
                "> 0.5" if spread == TENTHS else "not > 0.5",
                f"{left:.2f}",
                bool((left > 0.5) == (spread == TENTHS)),
            ),
            row("DI-F8", f"{name}: NEES x, y, z", "-", nees_all(each), None),
        ]
    return made


def nees_all(each: Found) -> str:
    return ", ".join(f"{a.nees.mean():.2f}" for a in each.axes)


def _honest(nees: float) -> bool:
    return 0.5 <= nees <= 2.0


def _homogeneous(found: Mapping[Key, Found]) -> list[Row]:
    made = []
    sure = {p: float(np.median(found[p, "published", ONES].axes[2].sure)) for p in REACHED}
    for place, minutes in REACHED.items():
        name = f"DI-F9{LETTERS[place]}"
        wanted = SURE[place]
        z = found[place, "published", ONES].axes[2]
        good = abs(sure[place] / wanted - 1) <= 0.2
        made.append(row(name, f"{place}: sigma of z below 0.02, min", f"{wanted:g}", band(z.sure, 1), good))
        for spread in (ONES, TENTHS):
            z = found[place, "published", spread].axes[2]
            what = f"  b_z reaches -0.08, first sigma {spread}, min"
            made.append(row(name, what, f"{minutes}", band(z.reach, 1), None))
            made.append(row(name, "  stays within 0.02 from, min", "-", band(z.settle, 1), None))
            made.append(row(name, "  NEES of z", "below 1: pessimistic", f"{z.nees.mean():.3f}",
                            bool(z.nees.mean() < 1) if spread == ONES else None))  # fmt: skip
    ordered = sure["equator"] < sure["munich"] < sure["north_pole"]
    told = ", ".join(f"{p} {sure[p]:.1f}" for p in REACHED)
    made.append(row("DI-F9", "order of these times", "equator < munich < north_pole", told, ordered))
    for place in REACHED:
        for variant in ("moving average", "state", "state, deviation", "state, street's deviation"):
            made += _faster(found, place, variant, "published")
    return made


def _faster(found: Mapping[Key, Found], scene: str, variant: str, base: str) -> list[Row]:
    """How much sooner than another form it settles, with either spread, and whether it knows its errors."""
    made = []
    for spread in (ONES, TENTHS):
        ours, theirs = (found[scene, v, spread].axes[2] for v in (variant, base))
        mine, other = np.median(ours.settle), np.median(theirs.settle)
        at_least = bool(np.isfinite(mine) and FASTER * mine <= other)
        told = f"{band(ours.settle)}, {base} {_plain(other)}"
        name = f"{scene}: {variant}, {spread}"
        made.append(row("DI-F9+", f"{name}: settles, min", "three times sooner", told, at_least))
        nees = float(ours.nees.mean())
        told = f"{nees:.2f} ({np.median(ours.nees):.2f} in the median); end {band(ours.end, 4)}"
        made.append(row("DI-F9+", "  NEES of z", "0.5 to 2", told, _honest(nees)))
    return made


def _plain(minutes: float) -> str:
    return f"{minutes:.2f}" if np.isfinite(minutes) else "never"


def _along(found: Mapping[Key, Found]) -> list[Row]:
    """North and south beside east and west: how long y takes, and what x and z do."""
    made = []
    for place in ("munich",):
        pair = [found[scene, "published", TENTHS] for scene in (f"{place}, north", place)]
        settled = [float(np.median(_settled(each, 1))) for each in pair]
        sigma = [[_halved(each, axis) for axis in range(3)] for each in pair]
        told = f"{settled[0]:.2f} against {settled[1]:.2f}"
        made.append(
            row("DI-t", f"{place}: b_y within 0.02, N-S and E-W, min", "N-S slightly sooner", told,
                settled[0] < settled[1])
        )  # fmt: skip
        told = ", ".join(f"{a:.2f}/{b:.2f}" for a, b in zip(*sigma, strict=True))
        made.append(row("DI-t", "  sigma halved x, y, z, N-S/E-W, min", "y sooner", told,
                        sigma[0][1] < sigma[1][1]))  # fmt: skip
        ends = [np.median(pair[0].axes[a].end) - np.median(pair[1].axes[a].end) for a in (0, 2)]
        told = f"{ends[0]:+.4f}, {ends[1]:+.4f}"
        made.append(row("DI-t", "  x, z at the end, N-S less E-W, deg/s", "unchanged", told,
                        bool(np.abs(ends).max() < 0.005)))  # fmt: skip
    return made


def _settled(each: Found, axis: int) -> np.ndarray:
    return each.axes[axis].settle


def _halved(each: Found, axis: int) -> float:
    sigma = each.told.sigma[:, axis].mean(axis=-1)
    under = sigma < 0.5 * sigma[0]
    return float(each.told.time[under.argmax()] / 60) if under.any() else float("inf")


def _perturbed(found: Mapping[Key, Found]) -> list[Row]:
    made = []
    variants = list(dict.fromkeys(v for s, v, _ in found if s == "same line"))
    for scene in ("same line", "same line, skips", "other lines", "other lines, skips"):
        for variant in variants:
            for spread in (ONES, TENTHS):
                if (scene, variant, spread) not in found:
                    continue
                z = found[scene, variant, spread].axes[2]
                nees = float(z.nees.mean())
                base = found[scene, "published, detector", spread].axes[2]
                mine, other = float(np.median(z.settle)), float(np.median(base.settle))
                name = f"{scene}: {variant}, {spread}"
                told = f"settles {band(z.settle)}, end {band(z.end, 3)}, NEES {nees:.2f}"
                published, good = "-", None
                if variant.startswith("state"):
                    sooner = np.isfinite(mine) and FASTER * mine <= other
                    published, good = "three times sooner, NEES 0.5 to 2", bool(sooner and _honest(nees))
                elif variant.startswith("published"):
                    published, good = "NEES > 1: overconfident", nees > 1
                made.append(row("DI-F10", name, published, told, good))
    return made


def _yaw(found: Mapping[Key, Found]) -> list[Row]:
    made = []
    for name, key in _YAWS.items():
        yaw = found[key].yaw
        most = np.abs(yaw).max(axis=0)
        told = f"end {band(yaw[-1], 0)}, at most {band(most, 0)}"
        if name.startswith("no"):
            wanted, good = "up to about 234", bool(abs(np.median(np.abs(yaw[-1])) - 234) < 30)
        else:
            wanted, good = "inside about +-30", bool(np.median(most) < 33)
        made.append(row("DI-F11", f"yaw error, {name}, deg", wanted, told, good))
    return made


def write_start(found: Mapping[Key, Found], out: Path) -> None:
    lines = [
        {
            "start": how, "variant": variant, "first_sigma_deg_s": spread,
            "z_reach_min": np.median(each.axes[2].reach), "z_settle_min": np.median(each.axes[2].settle),
            "z_end": np.median(each.axes[2].end), "z_nees": each.axes[2].nees.mean(),
            "yaw_end_deg": np.median(each.yaw[-1]),
        }
        for (how, variant, spread), each in found.items()
    ]  # fmt: skip
    write_table(out / "start.csv", {key: [line[key] for line in lines] for key in lines[0]})


def start_rows(found: Mapping[Key, Found]) -> list[Row]:
    made = []
    for (how, variant, spread), each in found.items():
        z = each.axes[2]
        told = f"reaches {band(z.reach, 1)}, settles {band(z.settle, 1)}, NEES {z.nees.mean():.2f}"
        made.append(row("DI-t", f"start: {how}, {variant}, {spread}", "-", told, None))
    return made
