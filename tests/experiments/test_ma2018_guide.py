"""What the guide of Ma 2018 claims is what the tables beside it say."""

import numpy as np
import pytest

from experiments import guide
from experiments.ma2018 import spread
from experiments.ma2018.guide import GUIDE

TEXT = GUIDE.path.read_text(encoding="utf-8")
SPREAD = {(x["place"], x["filter"]): x for x in guide.lines(guide.TABLES / "spread.csv")}


def test_its_tables_are_those_written():
    assert guide.with_blocks(TEXT, GUIDE.blocks()) == TEXT


STRONGER = "ZUPT, 0.01 m/s"


def test_every_place_and_filter_has_enough_walks():
    wanted = {(place, name) for place in spread.PLACES for name in spread.FILTERS if name != STRONGER}
    assert set(SPREAD) >= wanted | {(place, STRONGER) for place in ("office", "mall")}
    assert all(x["walks"] >= 18 for x in SPREAD.values())


@pytest.mark.parametrize(("place", "most"), spread.WANTED.items())
def test_what_was_wanted_is_met(place, most):
    assert SPREAD[place, "Ma"]["mean_m"] <= most


def test_a_ratio_and_its_interval():
    rng = np.random.default_rng(1)
    others = rng.uniform(1, 2, 40)
    assert spread.ratio(0.3 * others, others) == pytest.approx((0.3, 0.3, 0.3))
    value, low, high = spread.ratio(others, others[::-1])
    assert low < value < high
