"""The tables of docs/munozdiaz2017.md, from what the experiments wrote.

python -m experiments.munoz_diaz --out out/munoz_diaz
python -m experiments.munoz_diaz.phones --out out/phones
python -m experiments.munoz_diaz.strides --out out/strides
python -m experiments.munoz_diaz.guide out/munoz_diaz out/phones out/strides
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from experiments.guide import DOCS, Guide, Line, against, write

RULES = ("5", "8", "12")
MODELS = ("constant", "affine in swing", "Weinberg")


def phones(found: Sequence[Line]) -> str:
    """Means over walks and starts of the heading error, deg."""
    rows = [
        "| | clean | disturbed | worst | clean, start 0 | disturbed, start 0 | whole angle, clean, "
        "disturbed | yaw NEES, median | locked out |",
        "|---" * 9 + "|",
    ]
    for x in found:
        own = isinstance(x["yaw_nees_median"], float) and x["yaw_nees_median"] == x["yaw_nees_median"]
        said = f"{x['yaw_nees_median']:.2f} | {x['locked_out']:.0f}" if own else "- | -"
        rows.append(
            f"| {x['method']} | {x['clean_deg']:.2f} | {x['disturbed_deg']:.2f} | {x['worst_deg']:.1f} | "
            f"{x['clean_start_0_deg']:.2f} | {x['disturbed_start_0_deg']:.2f} | {x['total_clean_deg']:.2f}, "
            f"{x['total_disturbed_deg']:.2f} | {said} |"
        )
    return "\n".join(rows)


def _sizes(values: Sequence[float]) -> str:
    sizes = [abs(x) for x in values]
    return f"{sum(sizes) / len(sizes):.1f}, {max(sizes):.1f}"


def strides(found: Sequence[Line]) -> str:
    """Counts of strides by phone and cameras."""
    rows = ["| | phone | cameras at 5 | at 8 | at 12 degrees |", "|---" * 5 + "|"]
    for x in found:
        counts = " | ".join(f"{x[f'cameras_{rule}_deg']:.0f}" for rule in RULES)
        rows.append(f"| {x['walk']} | {x['strides']:.0f} | {counts} |")
    off = " | ".join(_sizes([x[f"off_{rule}_percent"] for x in found]) for rule in RULES)
    rows.append(f"| off by, mean and worst, % | | {off} |")
    return "\n".join(rows)


def distances(found: Sequence[Line]) -> str:
    """Errors of the distance by each model, fitted on the other subject."""
    rows = ["| | cameras, m | " + " | ".join(MODELS) + " |", "|---" * (len(MODELS) + 2) + "|"]
    for x in found:
        cells = " | ".join(f"{x[f'{name}_percent']:+.1f}" for name in MODELS)
        rows.append(f"| {x['walk']} | {x['cameras_m']:.1f} | {cells} |")
    off = " | ".join(_sizes([x[f"{name}_percent"] for x in found]) for name in MODELS)
    rows.append(f"| off by, mean and worst, % | | {off} |")
    return "\n".join(rows)


def tables(found: Mapping[str, Sequence[Line]]) -> dict[str, str]:
    """Each table of the guide by the name in its comment."""
    return {
        "figures": against(found["munoz_figures_told"]),
        "biases": against(found["munoz_biases_told"]),
        "trajectory": against(found["munoz_trajectory_told"]),
        "phones": phones(found["munoz_phones"]),
        "strides": strides(found["munoz_strides"]),
        "distances": distances(found["munoz_distances"]),
    }


GUIDE = Guide(
    DOCS / "munozdiaz2017.md",
    {
        "munoz_figures_told": "figures_told",
        "munoz_biases_told": "biases_told",
        "munoz_trajectory_told": "trajectory_told",
        "munoz_phones": "phones",
        "munoz_strides": "strides",
        "munoz_distances": "distances",
    },
    tables,
)

if __name__ == "__main__":
    write(__doc__, GUIDE)
