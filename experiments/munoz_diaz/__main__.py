"""Munoz Diaz 2017, its figures and statements: the published beside ours, and whether what was wanted is met.

    python -m experiments.munoz_diaz [figures] [biases] [trajectory]
        [--walks 20] [--first-seed 1200] [--out DIR]

Emulated walks take the place of the paper's recordings, which are not public. What it does not print was
chosen on seeds 0 to 5. A part takes 10 minutes or less on one core.
"""

from __future__ import annotations

from pathlib import Path

from experiments.munoz_diaz import biases, figures, trajectory
from experiments.table import Part, main_of

PARTS: dict[str, Part] = {
    "figures": figures.run,
    "biases": biases.run,
    "trajectory": trajectory.run,
}

if __name__ == "__main__":
    main_of(__doc__ or "", PARTS, Path("out/munoz_diaz"), 1200, lambda part: 20)
