"""Ma 2018, its tables and figures: the published number beside ours, and whether it is met.

    python -m experiments.ma2018 [calibration] [detection] [figures] [spread]
        [--walks 18] [--first-seed 400]

Simulated walks take the place of the paper's, which are not public: the calibration loop and free turning
(Table 1, Figs. 6, 7), the office (Figs. 3, 10, 11) and malls (Figs. 12, 15, 16), and the detectors in both
(Figs. 8, 13, 14). Nothing is tuned here; thresholds were chosen on other seeds.
"""

from __future__ import annotations

from pathlib import Path

from experiments.ma2018 import calibration, detection, figures, spread
from experiments.table import Part, main_of

PARTS: dict[str, Part] = {
    "calibration": calibration.run,
    "detection": detection.run,
    "figures": figures.run,
    "spread": spread.run,
}

if __name__ == "__main__":
    main_of(__doc__, PARTS, Path("out/ma2018"), 400, lambda part: 18)
