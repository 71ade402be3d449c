"""Wang 2018, its figures and statements: the published beside ours, and whether what was wanted is met.

    python -m experiments.wang [observability] [alignment] [branch] [noise] [walks]
        [--walks 50] [--first-seed 1100] [--out DIR]

Simulated stands and walks take the place of the paper's, which are not public; it prints no number but the
alignment's. Nothing is tuned here: presets and defaults were chosen on seeds 0 to 11. Walks were looked at
three times: at seeds 900 to 949 and 1000 to 1049 before the last change, told in the guide, and at 1100 on.
"""

from __future__ import annotations

from pathlib import Path

from experiments.table import Part, main_of
from experiments.wang import alignment, branch, noise, observability, walks

PARTS: dict[str, Part] = {
    "observability": observability.run,
    "alignment": alignment.run,
    "branch": branch.run,
    "noise": noise.run,
    "walks": walks.run,
}

if __name__ == "__main__":
    main_of(__doc__, PARTS, Path("out/wang"), 1100, lambda part: 50)
