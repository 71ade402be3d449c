"""What the guide of Wang 2018 claims is what the tables beside it say."""

import pytest

from experiments import guide
from experiments.wang.guide import GUIDE

TEXT = GUIDE.path.read_text(encoding="utf-8")
WALKS = {(x["condition"], x["path"], x["variant"]): x for x in guide.lines(guide.TABLES / "wang_walks.csv")}
PATHS = ("rectangle", "circle", "irregular")


def test_its_tables_are_those_written():
    assert guide.with_blocks(TEXT, GUIDE.blocks()) == TEXT


def test_every_place_has_fifty_walks():
    assert len(WALKS) > 80
    assert all(x["walks"] == 50 for x in WALKS.values())


@pytest.mark.parametrize("path", PATHS)
@pytest.mark.parametrize("kind", ["rms_median_m", "gps_median_m"])
def test_medians_are_in_the_order_of_the_paper(path, kind):
    start, zupt, improved = (WALKS["changing", path, v][kind] for v in ("ZUPT + start", "ZUPT", "improved"))
    assert improved < start < zupt


@pytest.mark.parametrize("path", PATHS)
def test_a_disturbed_start_is_no_harm_to_the_best(path):
    best, zero, improved = (
        WALKS["disturbed start", path, v]["rms_median_m"] for v in ("best, no rest", "alpha zero", "improved")
    )
    assert best < 0.5 * min(zero, improved)
