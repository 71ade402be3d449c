"""What a sweep's report says, against sweeps whose answer is known."""

import io

import numpy as np
import pytest

from pedjax.errors import InputError
from pedjax.output import write_table
from pedjax.plots import sweeps
from pedjax.sweeping import report as rp
from pedjax.sweeping import telling
from pedjax.sweeping.designs import Axis

AXES = [
    Axis("gate.threshold", "1", True, 1e2, 1e6),
    Axis("noise.gyroscope", "rad/s/sqrt(Hz)", True, 1e-4, 1e-1),
    Axis("stance.window", "s", False, 0.05, 0.25),
]
SETTINGS = {"stance.rule": ["causal", "any"]}


def made(count=400, recordings=3, seed=0, lost=True):
    """A valley in the threshold, a slope in the noise, nothing in the window, a corner that diverges."""
    rng = np.random.default_rng(seed)
    unit = rng.random((count, 3))
    values = {}
    for axis, u in zip(AXES, unit.T, strict=True):
        low, high = axis.forward([axis.low, axis.high])
        own = low + u * (high - low)
        values[axis.path] = np.exp(own) if axis.log else own
    rule = np.array(["causal", "any"], object)[np.arange(count) % 2]
    valley = np.linspace(0.4, 0.6, recordings) if recordings > 1 else np.array([0.5])
    score = 10 ** (4 * (unit[:, :1] - valley) ** 2 - 0.5 * unit[:, 1:2] + 0.1 * (rule == "any")[:, None])
    if lost:
        score[(unit[:, 0] > 0.8) & (unit[:, 1] < 0.3), 0] = np.nan
    columns = {path: np.repeat(v, recordings) for path, v in values.items()}
    flat = score.ravel()
    return {
        "run": np.repeat(np.arange(count), recordings),
        "recording": np.tile(np.array([f"walk{r}" for r in range(recordings)], object), count),
        **columns,
        "stance.rule": np.repeat(rule, recordings),
        "armse_m": flat,
        "final_2d_m": flat * rng.uniform(0.5, 2.0, len(flat)),
        "max_2d_m": 2 * flat,
        "rms_3d_m": np.full(len(flat), np.nan),
        "healthy": np.isfinite(flat),
    }


def scores_only(values, **more):
    """One recording, scores as given."""
    values = np.asarray(values, float)
    return {
        "run": np.arange(len(values)),
        "recording": np.full(len(values), "walk"),
        "armse_m": values,
        "healthy": np.isfinite(values),
        **more,
    }


def rows(columns, keep):
    return {name: column[keep] for name, column in columns.items()}


def test_per_run_is_the_mean_over_recordings():
    columns = made()
    order = np.random.default_rng(1).permutation(len(columns["run"]))
    runs = rp.per_run(rows(columns, order), "armse_m")
    for place, run in enumerate(runs.run):
        own = columns["armse_m"][columns["run"] == run]
        np.testing.assert_allclose(runs.score[place], own.mean(), rtol=1e-14)
        assert runs.diverged[place] == np.isnan(own).any()
        assert columns["run"][order][runs.row[place]] == run
    assert runs.diverged.any()
    assert not runs.incomplete.any()


def test_unhealthy_runs_diverged_whatever_their_score():
    columns = scores_only([0.1, 0.2, 0.3])
    columns["healthy"] = np.array([False, True, True])
    runs = rp.per_run(columns, "armse_m")
    assert runs.diverged.tolist() == [True, False, False]
    assert rp.best(runs, 1).tolist() == [1]


def test_runs_cut_off_are_left_out_and_not_called_diverged():
    columns = made(20, lost=False)
    runs = rp.per_run(rows(columns, np.arange(57)), "armse_m")
    assert runs.incomplete.tolist() == [False] * 19
    runs = rp.per_run(rows(columns, np.arange(59)), "armse_m")
    assert runs.incomplete.sum() == 1
    assert np.isnan(runs.score[-1])
    assert not runs.diverged.any()


def test_rows_that_come_twice_count_once():
    columns = made(20, lost=False)
    again = rows(columns, np.append(np.arange(60), [0, 1, 7]))
    np.testing.assert_array_equal(rp.per_run(again, "armse_m").score, rp.per_run(columns, "armse_m").score)


def test_a_recording_without_the_score_is_left_out():
    columns = made(20, lost=False)
    columns["rms_3d_m"] = np.where(columns["recording"] == "walk1", np.nan, columns["armse_m"])
    runs = rp.per_run(columns, "rms_3d_m")
    assert runs.recordings == ("walk0", "walk2")
    assert not runs.diverged.any()


def test_unknown_and_empty_scores_are_said():
    with pytest.raises(InputError, match="did you mean 'armse_m'"):
        rp.per_run(made(5), "armse")
    with pytest.raises(InputError, match="has no value"):
        rp.per_run(made(5, lost=False), "rms_3d_m")
    with pytest.raises(InputError, match="no column"):
        rp.analyse(made(5), [Axis("gate.treshold", "1", True, 1, 2)])
    with pytest.raises(InputError, match="holds no runs"):
        rp.per_run(rows(made(5), np.arange(0)), "armse_m")


def test_best_are_sorted_and_ties_keep_their_order():
    runs = rp.per_run(scores_only([3, 1, np.nan, 1, 2, 1]), "armse_m")
    assert rp.best(runs, 2).tolist() == [1, 3]
    assert rp.best(runs, 50).tolist() == [1, 3, 5, 4, 0]


def test_marginals_are_quantiles_of_each_bin():
    columns = made(2000)
    runs = rp.per_run(columns, "armse_m")
    values = {a.path: columns[a.path][runs.row] for a in AXES}
    found = rp.marginals(runs, values, AXES)["gate.threshold"]
    edges = np.geomspace(1e2, 1e6, len(found.count) + 1)
    np.testing.assert_allclose(found.bins.edges, edges)
    assert found.count.sum() == 2000
    for b in range(len(found.count)):
        inside = (values["gate.threshold"] >= edges[b]) & (values["gate.threshold"] < edges[b + 1])
        fine = inside & np.isfinite(runs.score)
        np.testing.assert_allclose(found.quantiles[:, b], np.quantile(runs.score[fine], rp.QUANTILES))
        assert found.minimum[b] == runs.score[fine].min()
        assert found.diverged[b] == pytest.approx(1 - fine.sum() / inside.sum())


def test_pairs_are_medians_of_each_cell():
    columns = made(1000)
    runs = rp.per_run(columns, "armse_m")
    values = {a.path: columns[a.path][runs.row] for a in AXES} | {
        "stance.rule": columns["stance.rule"][runs.row]
    }
    pair = rp.pairs(runs, values, AXES, SETTINGS)["stance.window", "stance.rule"]
    assert pair.y.labels == ("causal", "any")
    i, j = 2, 1
    cell = (pair.x.index == i) & (values["stance.rule"] == "any") & np.isfinite(runs.score)
    assert pair.median[i, j] == pytest.approx(np.median(runs.score[cell]))
    assert pair.minimum[i, j] == runs.score[cell].min()
    assert np.isnan(pair.median[pair.count == 0]).all()


def test_a_grid_has_a_bin_for_each_step():
    steps = np.geomspace(1e2, 1e6, 5)
    values = {"gate.threshold": np.repeat(steps, 20)}
    runs = rp.per_run(scores_only(np.arange(1.0, 101.0)), "armse_m")
    found = rp.marginals(runs, values, AXES[:1])["gate.threshold"]
    assert found.count.tolist() == [20] * 5
    np.testing.assert_allclose(found.bins.centres, steps)


@pytest.mark.parametrize("seed", range(4))
def test_pareto_against_brute_force(seed):
    """Coarse numbers, so that ties in one score and in both are many."""
    rng = np.random.default_rng(seed)
    one, two = rng.integers(1, 12, 150) / 4, rng.integers(1, 12, 150) / 4
    if seed % 2:
        one, two = rng.random(150), rng.random(150)
    one[rng.random(150) < 0.1] = np.nan
    found = rp.pareto(
        scores_only(one, final_2d_m=np.where(np.isnan(one), np.nan, two)), "armse_m", "final_2d_m"
    )
    fine = np.flatnonzero(np.isfinite(one))
    kept = [
        k
        for k in fine
        if not any(
            one[m] <= one[k] and two[m] <= two[k] and (one[m], two[m]) != (one[k], two[k]) for m in fine
        )
    ]
    assert sorted(found.place.tolist()) == kept
    assert (np.diff(one[found.place]) >= 0).all()


def test_only_the_slope_is_warned_of():
    columns = made(2000)
    found = rp.analyse(columns, AXES, SETTINGS)
    crowded = [(edge.path, edge.side) for edge in found.edges if edge.crowd]
    assert crowded == [("noise.gyroscope", "high")]
    assert any("noise.gyroscope" in line and "widen" in line for line in telling.describe(found))
    assert not any("threshold" in line and "widen" in line for line in telling.describe(found))


def test_flatness_and_regret():
    columns = made(3000, lost=False)
    found = rp.analyse(columns, AXES, SETTINGS)
    spans = found.spans
    assert spans["gate.threshold"].share < 0.35
    assert spans["noise.gyroscope"].high > 0.08
    assert spans["stance.window"].share > 0.5
    score = found.runs.score
    close = score <= 1.05 * score.min()
    assert found.near == close.sum()
    assert spans["stance.window"].low == found.values["stance.window"][close].min()
    assert found.choices["stance.rule"] == ("causal",)
    each = score_table(columns)
    for regret in found.regrets:
        r = int(regret.recording.removeprefix("walk"))
        assert regret.own == each[:, r].min()
        assert regret.run == each[:, r].argmin()
        assert regret.at == each[each.mean(axis=1).argmin(), r]
    # the valley of the middle recording is that of the mean
    assert found.regrets[-1].recording == "walk1"


def score_table(columns):
    return columns["armse_m"].reshape(-1, 3)


def test_effects_find_valley_slope_and_nothing():
    found = rp.analyse(made(1000), AXES, SETTINGS).effects
    assert [found.names[i] for i in found.order] == [
        "gate.threshold", "noise.gyroscope", "stance.rule", "stance.window",
    ]  # fmt: skip
    assert found.total[2] < 0.01
    assert found.q2 > 0.95


def check_all(found, tmp_path):
    tables = telling.report_tables(found)
    for name, table in tables.items():
        write_table(tmp_path / f"{name}.csv", table)
        lines = (tmp_path / f"{name}.csv").read_text().splitlines()
        assert {line.count(",") for line in lines} == {len(table) - 1 if table else 0}
    lines = telling.describe(found)
    assert len(lines) <= 40
    for draw in (sweeps.marginal_figure, sweeps.pair_figure, sweeps.effects_figure, sweeps.pareto_figure):
        draw(found).savefig(io.BytesIO(), dpi=40)
    return tables, lines


def test_tables_words_and_figures(tmp_path):
    found = rp.analyse(made(300), AXES, SETTINGS, second="max_2d_m")
    tables, lines = check_all(found, tmp_path)
    assert tables["best"]["run"][0] == found.runs.run[np.nanargmin(found.runs.score)]
    assert tables["optimum"]["unit"] == [axis.unit for axis in AXES]
    assert sum(tables["marginals"]["runs"]) == 4 * 300
    assert "300 runs over 3 parameters and 1 setting on 3 recordings" in lines[0]


@pytest.mark.parametrize(
    "kind", ["one run", "one parameter", "constant", "all diverged", "same run", "no setting"]
)
def test_odd_sweeps(kind, tmp_path):
    columns, axes, settings = made(40, lost=False), AXES, SETTINGS
    if kind == "one run":
        columns = rows(columns, columns["run"] == 0)
    elif kind == "one parameter":
        axes, settings = AXES[:1], {}
    elif kind == "constant":
        columns["armse_m"] = np.full(120, 0.25)
    elif kind == "all diverged":
        columns |= {name: np.full(120, np.nan) for name in ("armse_m", "final_2d_m", "max_2d_m")}
        columns["healthy"] = np.zeros(120, bool)
    elif kind == "same run":
        columns |= {axis.path: np.full(120, axis.low) for axis in AXES} | {"armse_m": np.full(120, 0.5)}
    else:
        settings = {}
    found = rp.analyse(columns, axes, settings)
    _, lines = check_all(found, tmp_path)
    if kind == "all diverged":
        assert "no run got through" in lines[-1]
        assert not len(found.best)
    if kind == "constant":
        assert any("same in every run" in line for line in lines)
    if kind in ("one run", "same run"):
        assert any("too few" in line for line in lines)


def test_many_runs_are_drawn_as_a_density(tmp_path):
    found = rp.analyse(made(6000, recordings=1), AXES, SETTINGS)
    check_all(found, tmp_path)
