"""What the guide of Munoz Diaz 2017 claims is what the tables beside it say."""

import pytest

from experiments import guide
from experiments.munoz_diaz.guide import GUIDE

TEXT = GUIDE.path.read_text(encoding="utf-8")
PHONES = {x["method"]: x for x in guide.lines(guide.TABLES / "munoz_phones.csv")}
BIASES = {
    (x["scene"], x["variant"], x["first_sigma_deg_s"]): x
    for x in guide.lines(guide.TABLES / "munoz_biases.csv")
}


def test_its_tables_are_those_written():
    assert guide.with_blocks(TEXT, GUIDE.blocks()) == TEXT


def test_every_walk_has_twenty_seeds():
    assert len(BIASES) > 70
    assert all(x["seeds"] == 20 for x in BIASES.values())


@pytest.mark.parametrize("spread", [0.57, 0.039])
def test_a_field_state_of_the_street_is_sooner_and_honest(spread):
    for line in ("same line", "other lines"):
        state = BIASES[line, "state, street's deviation, detector", spread]
        assert 0.5 < state["z_nees"] < 2
    state, published = (
        BIASES["same line", name, spread]
        for name in ("state, street's deviation, detector", "published, detector")
    )
    assert 3 * state["z_settle_min"] < published["z_settle_min"]


def test_pockets_are_beside_vqf_as_told():
    vqf, clip, given = (PHONES[name] for name in ("VQF", "VQF, clip 10", "VQF, clip 10, prior"))
    plain, prior, twice = (PHONES[name] for name in ("pocket", "pocket, prior", "pocket, two passes"))
    assert prior["disturbed_deg"] < 0.6 * vqf["disturbed_deg"]
    assert prior["disturbed_deg"] < 0.75 * given["disturbed_deg"]
    assert prior["clean_deg"] < given["clean_deg"] + 0.3
    assert twice["disturbed_deg"] < 3.5
    assert twice["clean_deg"] < 2.5
    assert plain["clean_deg"] < clip["clean_deg"]
    assert plain["disturbed_deg"] < clip["disturbed_deg"]


def test_strides_are_as_told():
    off = [abs(x["off_8_percent"]) for x in guide.lines(guide.TABLES / "munoz_strides.csv")]
    assert len(off) == 8
    assert sum(off) / 8 < 2
    assert max(off) < 4
