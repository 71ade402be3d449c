"""The table of scores: what each needs, what it is called, and one of your own."""

import jax.numpy as jnp
import numpy as np
import pytest

from pedjax.errors import InputError
from pedjax.evaluation import scores
from pedjax.evaluation.heading import heading_rms
from pedjax.evaluation.landmarks import landmark_errors
from pedjax.evaluation.scores import SCORES, ScoreKind, register_loss, score_kind, told_with
from pedjax.walks import reference_of

POSITIONS = ("armse", "rms_2d", "mean_2d", "max_2d", "final_2d", "rms_3d")


@pytest.fixture
def own(monkeypatch):
    """A registry of which this test may dispose."""
    monkeypatch.setattr(scores, "SCORES", dict(SCORES))
    return scores.SCORES


def test_every_score_is_by_its_name_and_in_a_unit():
    assert {name: kind.name for name, kind in SCORES.items()} == {name: name for name in SCORES}
    assert {*POSITIONS, "heading_rms"} <= SCORES.keys()
    for name in POSITIONS:
        assert score_kind(name).column == f"{name}_m"
        assert score_kind(name).keep == ("position",)
    assert score_kind("heading_rms").column == "heading_rms_deg"
    assert score_kind("heading_rms").keep == ("attitude",)
    assert {kind.known for kind in SCORES.values()} == {"xy", "xyz", "attitude"}
    assert len({kind.column for kind in SCORES.values()}) == len(SCORES)
    assert all(kind.title for kind in SCORES.values())


@pytest.mark.parametrize("alignment", ["none", "yaw_translation"])
def test_a_score_is_the_error_of_that_name(rng, alignment):
    estimate, truth = rng.normal(size=(2, 7, 3))
    reference = reference_of(truth)
    errors = landmark_errors(jnp.asarray(estimate), reference, alignment)
    for name in POSITIONS:
        found = SCORES[name].of({"position": jnp.asarray(estimate)}, reference, alignment)
        assert float(found) == float(getattr(errors, name))
    turns = np.linalg.qr(rng.normal(size=(2, 7, 3, 3)))[0]
    reference = reference_of(truth, attitude=turns[0])
    found = SCORES["heading_rms"].of({"attitude": jnp.asarray(turns[1])}, reference, alignment)
    assert float(found) == float(heading_rms(jnp.asarray(turns[1]), reference))


def test_what_is_told_with_a_loss():
    """All that positions give; headings need a truth that most recordings have not."""
    for loss in POSITIONS:
        assert [kind.name for kind in told_with(loss)] == list(POSITIONS)
    assert [kind.name for kind in told_with("heading_rms")] == [*POSITIONS, "heading_rms"]


def test_an_unknown_score_is_refused():
    with pytest.raises(InputError, match="loss 'rms_2' is unknown; did you mean 'rms_2d'"):
        score_kind("rms_2")


def test_a_loss_of_ones_own(own):
    kind = ScoreKind(
        "speed", "m/s", "speed", lambda e, r, a: jnp.mean(e["velocity"][:, 0], axis=0), ("velocity",)
    )
    assert register_loss(kind) is kind
    assert score_kind("speed") is kind
    assert kind.column == "speed_m/s"
    assert (kind.known, own["speed"]) == ("xy", kind)
    # told with itself only: others do not keep the velocity
    assert [k.name for k in told_with("speed")] == [*POSITIONS, "speed"]
    assert [k.name for k in told_with("armse")] == list(POSITIONS)
    height = register_loss(ScoreKind("height", "m", "height", lambda e, r, a: e["position"][-1, 2]))
    assert [k.name for k in told_with("armse")] == [*POSITIONS, "height"]
    assert register_loss(height._replace(title="again")) is own["height"]
    assert score_kind("height").title == "again"
