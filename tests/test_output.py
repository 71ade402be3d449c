"""Tables on disk are read back as they were, whatever is in their texts."""

import csv

import numpy as np

from pedjax.output import write_table


def test_text_with_commas_stays_in_its_column(tmp_path):
    names = ["plain", "left, right", 'the "third"', "two\nlines"]
    write_table(tmp_path / "t.csv", {"recording": names, "error_m": [0.5, np.float64(1 / 3), np.nan, 2]})
    with (tmp_path / "t.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert [row["recording"] for row in rows] == names
    assert [row["error_m"] for row in rows] == ["0.5", "0.333333333", "nan", "2"]
    assert (tmp_path / "t.csv").read_bytes().startswith(b"recording,error_m\nplain,0.5\n")
