"""The tables of docs/munozdiaz2017.md, from what the experiments wrote.

python -m experiments.munoz_diaz --out out/munoz_diaz
python -m experiments.munoz_diaz.phones --out out/phones
python -m experiments.munoz_diaz.strides --out out/strides
python -m experiments.munoz_diaz.guide out/munoz_diaz out/phones out/strides
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from experiments.guide import DOCS, Guide, Line, against, write

TOLD = ("DI-F8", "DI-F9", "DI-F9a", "DI-F9b", "DI-F9c", "DI-F11")
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


SCENES = {
    "north_pole": "Pole",
    "equator": "Equator",
    "munich": "Munich",
    "same line": "street, same line back",
    "other lines": "street, other lines back",
}


def biases(found: Sequence[Line]) -> str:
    """Of b_z by form and scene at both first spreads: minutes until it stays within 0.02 deg/s of the truth,
    the last bias, and NEES."""
    heads = "settles, min | at the end, deg/s | NEES | settles | at the end | NEES"
    rows = [f"| | form | {heads} |", "|---" * 8 + "|"]
    of = {(x["scene"], x["variant"], x["first_sigma_deg_s"]): x for x in found}
    for scene, name in SCENES.items():
        for variant in dict.fromkeys(x["variant"] for x in found if x["scene"] == scene):
            if variant == "gravity":
                continue
            cells = []
            for spread in (0.57, 0.039):
                x = of[scene, variant, spread]
                settles = "never" if x["z_settle_min"] == float("inf") else f"{x['z_settle_min']:.2f}"
                cells.append(f"{settles} | {x['z_end']:.3f} | {x['z_nees']:.2f}")
            rows.append(f"| {name} | {variant} | {' | '.join(cells)} |")
    return "\n".join(rows)


def tracks(found: Sequence[Line]) -> str:
    """Biases and track of section 3.2 by form."""
    rows = [
        "| | first sigma, deg/s | b at the end, deg/s | after the first round: yaw, deg; away, m | yaw in "
        "all, deg |",
        "|---" * 5 + "|",
    ]
    for x in found:
        bias = ", ".join(f"{x[f'{axis}_end']:.3f}" for axis in "xyz")
        first = f"{x['yaw_round_deg']:.0f}; {x['away_round_m']:.0f}"
        rows.append(
            f"| {x['run']} | {x['first_sigma_deg_s']:g} | {bias} | {first} | {x['yaw_total_deg']:.0f} |"
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


def broad(found: Sequence[Line]) -> str:
    """Heading errors on BROAD, deg."""
    names = [key.removesuffix("_deg") for key in found[0] if key.endswith("_deg")]
    rows = ["| | " + " | ".join(names) + " |", "|---" * (len(names) + 1) + "|"]
    for x in found:
        rows.append(f"| {x['trial']} | " + " | ".join(f"{x[f'{n}_deg']:.2f}" for n in names) + " |")
    return "\n".join(rows)


def tables(found: Mapping[str, Sequence[Line]]) -> dict[str, str]:
    """Each table of the guide by the name in its comment."""
    return {
        "figures": against(found["munoz_figures_told"]),
        "told": against(found["munoz_biases_told"], TOLD),
        "biases": biases(found["munoz_biases"]),
        "tracks": tracks(found["munoz_trajectory"]),
        "broad": broad(found["munoz_broad"]),
        "phones": phones(found["munoz_phones"]),
        "strides": strides(found["munoz_strides"]),
        "distances": distances(found["munoz_distances"]),
    }


GUIDE = Guide(
    DOCS / "munozdiaz2017.md",
    {
        "munoz_figures_told": "figures_told",
        "munoz_biases_told": "biases_told",
        "munoz_biases": "biases",
        "munoz_trajectory": "trajectory",
        "munoz_trajectory_told": "trajectory_told",
        "munoz_broad": "phones_broad",
        "munoz_phones": "phones",
        "munoz_strides": "strides",
        "munoz_distances": "distances",
    },
    tables,
)

if __name__ == "__main__":
    write(__doc__, GUIDE)
