"""AIEZ, its figures and table: the published number beside ours, and whether what was wanted is met.

    python -m experiments.aiez [table1] [magnet] [lockout] [straight] [wayback]
        [--walks 18] [--first-seed 700] [--out DIR]

Simulated walks take the place of the paper's, which are not public. Nothing is tuned here: presets,
thresholds and defaults were chosen on seeds 0 to 11. Table I takes 50 walks unless --walks says otherwise.
"""

from __future__ import annotations

from pathlib import Path

from experiments.aiez import lockout, magnet, straight, table1, wayback
from experiments.table import Part, main_of

PARTS: dict[str, Part] = {
    "table1": table1.run,
    "magnet": magnet.run,
    "lockout": lockout.run,
    "straight": straight.run,
    "wayback": wayback.run,
}

if __name__ == "__main__":
    main_of(__doc__, PARTS, Path("out/aiez"), 700, lambda part: 50 if part == "table1" else 18)
