"""Noise of known make is found again, with the spread that is stated."""

import numpy as np
import pytest
from scipy.signal import lfilter

from pedjax.errors import InputError
from pedjax.evaluation import noise as model
from pedjax.evaluation.allan import AllanCurve, allan_curve, log_sizes
from pedjax.evaluation.noise import (
    IEEE_FACTOR,
    PARAMETERS,
    TERMS,
    Noise,
    allan_parts,
    identify,
    point_covariance,
    published_gauss_markov,
    read_off,
)

RATE = 10.0


def simulated(seed, samples, white=0.0, walk=0.0, std=0.0, time=1.0, rate=RATE):
    """White noise (u sqrt(s)), a random walk (u / sqrt(s)) and a stationary Gauss-Markov process."""
    rng = np.random.default_rng(seed)
    values = white * np.sqrt(rate) * rng.normal(size=samples)
    if walk:
        values = values + np.cumsum(walk / np.sqrt(rate) * rng.normal(size=samples))
    if std:
        c = np.exp(-1 / (rate * time))
        drive = std * np.sqrt(1 - c**2) * rng.normal(size=samples)
        drive[0] = std * rng.normal()
        values = values + lfilter([1.0], [1.0, -c], drive)
    return values


def curve_of(tau, *channels, samples=10**7, rate=RATE):
    """A curve without error."""
    deviation = np.stack(channels, axis=1)
    return AllanCurve(np.rint(tau * rate).astype(int), tau, deviation, 1e3 / deviation, samples, rate)


def vector(**values):
    return np.array([values.get(name, 1.0 if name == "gauss_markov_time" else 0.0) for name in PARAMETERS])


# -------------------------------------------------------------------------------------------- the model


def gauss_markov_deviation(std, time, tau):
    values = vector(gauss_markov_std=std, gauss_markov_time=time)
    return np.sqrt(allan_parts(values, tau)[:, -1])


def test_gauss_markov_has_its_peak_where_it_is_published():
    tau = np.geomspace(1.0, 1e4, 200_001)
    deviation = gauss_markov_deviation(0.01, 300.0, tau)
    assert tau[deviation.argmax()] / 300.0 == pytest.approx(1.893, abs=1e-3)
    assert deviation.max() / 0.01 == pytest.approx(0.617, abs=5e-4)


def test_gauss_markov_equals_the_printed_form():
    std, time, tau = 0.3, 7.0, np.geomspace(0.5, 500.0, 30)
    q = std * np.sqrt(2 / time)
    bracket = 1 - time / (2 * tau) * (3 - 4 * np.exp(-tau / time) + np.exp(-2 * tau / time))
    printed = np.sqrt(q**2 * time**2 / tau * bracket)
    np.testing.assert_allclose(gauss_markov_deviation(std, time, tau), printed, rtol=1e-9)


def test_gauss_markov_is_a_random_walk_at_first_and_white_at_last():
    std, time = 0.3, 100.0
    early = gauss_markov_deviation(std, time, np.array([1e-3]))
    np.testing.assert_allclose(early, std * np.sqrt(2 / time) * np.sqrt(1e-3 / 3), rtol=1e-4)
    late = gauss_markov_deviation(std, time, np.array([1e6]))
    np.testing.assert_allclose(late, std * np.sqrt(2 * time / 1e6), rtol=1e-3)


def test_slope_of_the_gauss_markov_part():
    for x in (1e-3, 0.0099, 0.0101, 0.5, 3.0, 40.0):
        step = 1e-5
        ahead, behind = (model._gauss_markov(np.array(x * np.exp(-s)))[0] for s in (step, -step))
        slope = model._gauss_markov(np.array(x))[1]
        assert slope == pytest.approx((ahead - behind) / (2 * step), rel=1e-4)


def test_every_part_is_that_of_a_simulation():
    rng, n = np.random.default_rng(0), 400_000
    drive = rng.normal(size=n + 1)
    made = {
        "quantisation": (0.02, np.diff(drive) * RATE * 0.02),
        "white": (0.1, simulated(1, n, white=0.1)),
        "random_walk": (0.01, simulated(2, n, walk=0.01)),
        "ramp": (1e-3, 1e-3 * np.arange(n) / RATE),
    }
    for name, (value, samples) in made.items():
        curve = allan_curve(samples, RATE, [20, 100, 400])
        expected = np.sqrt(allan_parts(vector(**{name: value}), curve.tau).sum(axis=-1))
        np.testing.assert_allclose(curve.deviation[:, 0], expected, rtol=0.06, err_msg=name)


@pytest.mark.parametrize("name", ["white", "quantisation", "bias_instability", "random_walk", "gauss_markov"])
def test_structure_gives_the_allan_variance(name):
    """The second difference of the integral has twice the Allan variance, whichever way it is found."""
    values = (
        vector(gauss_markov_std=0.2, gauss_markov_time=3.0)
        if name == "gauss_markov"
        else vector(**{name: 0.2})
    )
    tau = np.array([0.1, 1.0, 5.0, 40.0])
    taps = np.array([1.0, -2.0, 1.0])
    second = sum(
        taps[i] * taps[j] * model._structure(values, (i - j) * tau) for i in range(3) for j in range(3)
    )
    np.testing.assert_allclose(
        second / (2 * tau**2), allan_parts(values, tau).sum(axis=-1), rtol=1e-6, atol=1e-12
    )


def test_covariance_of_points_is_what_simulations_have():
    values = vector(white=0.1, gauss_markov_std=0.1, gauss_markov_time=5.0)
    sizes = np.array([1, 4, 16, 64, 128])
    runs = np.stack([simulated(s, 1500, white=0.1, std=0.1, time=5.0) for s in range(1500)], axis=1)
    curve = allan_curve(runs, RATE, sizes)
    seen = np.cov(np.log(curve.deviation**2))
    expected = point_covariance(values, curve)
    spread, expected_spread = np.sqrt(np.diag(seen)), np.sqrt(np.diag(expected))
    np.testing.assert_allclose(expected_spread, spread, rtol=0.07)
    np.testing.assert_allclose(
        expected / np.outer(expected_spread, expected_spread), seen / np.outer(spread, spread), atol=0.08
    )


@pytest.mark.parametrize(
    "values",
    [
        {"white": 0.1},
        {"bias_instability": 0.1},
        {"random_walk": 0.1},
        {"quantisation": 0.1},
        {"white": 0.1, "ramp": 1e-3},
        {"white": 0.1, "gauss_markov_std": 0.1, "gauss_markov_time": 10.0},
    ],
)
def test_covariance_equals_the_sum_over_every_lag(values, rng):
    values = vector(**values)
    curve = allan_curve(rng.normal(size=1200), RATE, log_sizes(1200, per_decade=4))
    expected = np.zeros((len(curve.size),) * 2)
    taps = (1.0, -2.0, 1.0)
    for i, a in enumerate(curve.size):
        for j, b in enumerate(curve.size):
            many_a, many_b = 1201 - 2 * a, 1201 - 2 * b
            lag = np.arange(1 - many_a, many_b)
            count = np.minimum(many_a, many_b - lag) - np.maximum(0, -lag)
            both = sum(
                taps[p] * taps[q] * model._structure(values, (lag + q * b - p * a) / RATE)
                for p in range(3)
                for q in range(3)
            )
            both *= RATE**2 / (a * b)
            ramp = (values[4] / RATE) ** 2 * a * b * (count * both).sum()
            expected[i, j] = (0.5 * (count * both**2).sum() + ramp) / (many_a * many_b)
    found = point_covariance(values, curve)
    scale, spread = np.sqrt(np.diag(expected)), np.sqrt(np.diag(found))
    np.testing.assert_allclose(found / np.outer(spread, spread), expected / np.outer(scale, scale), atol=0.02)
    variance = allan_parts(values, curve.tau).sum(axis=-1)
    edf = 2 * variance**2 / np.diag(expected)
    np.testing.assert_allclose(model._edf_of(np.diag(found)), edf, rtol=0.03)


# --------------------------------------------------------------------------------------- identification

CASES = {
    "white": (("white",), {"white": 0.1}),
    "walk": (("white", "random_walk"), {"white": 0.1, "random_walk": 0.01}),
    "gauss_markov": (
        ("white", "gauss_markov"),
        {"white": 0.1, "gauss_markov_std": 0.1, "gauss_markov_time": 10.0},
    ),
}


@pytest.fixture(scope="module", params=CASES)
def twenty(request):
    """What is found in twenty recordings of the same make, and the truth."""
    terms, truth = CASES[request.param]
    made = {
        "white": truth["white"],
        "walk": truth.get("random_walk", 0.0),
        "std": truth.get("gauss_markov_std", 0.0),
        "time": truth.get("gauss_markov_time", 1.0),
    }
    runs = np.stack([simulated(seed, 40_000, **made) for seed in range(20)], axis=1)
    return terms, truth, identify(allan_curve(runs, RATE))


def test_terms_are_found_and_no_others(twenty):
    terms, _, found = twenty
    assert [noise.terms for noise in found].count(terms) >= 19
    assert np.median([noise.support[t] for noise in found for t in terms]) > 0.95


def test_values_are_found_with_the_spread_that_is_stated(twenty):
    terms, truth, found = twenty
    right = [noise for noise in found if noise.terms == terms]
    for name, value in truth.items():
        values = np.array([noise.values[name] for noise in right])
        sigmas = np.array([noise.sigmas[name] for noise in right])
        assert np.median(values) == pytest.approx(value, rel=0.1)
        assert np.median(np.abs(values / value - 1)) < 0.1
        off = (values - value) / sigmas
        assert (np.abs(off) < 4).all(), (name, off)
        assert 0.6 < np.sqrt(np.mean(off**2)) < 1.5, (name, off)


def test_fits_leave_what_chance_leaves(twenty):
    _, _, found = twenty
    assert 0.6 < np.mean([noise.chi2 / noise.dof for noise in found]) < 1.5
    assert [noise.misfit for noise in found].count(0.0) >= 18


def test_quantisation_and_a_ramp_are_found():
    rng, n = np.random.default_rng(104), 60_000
    samples = simulated(4, n, white=0.1) + 0.02 * RATE * np.diff(rng.normal(size=n + 1))
    ramp = simulated(5, n, white=0.1) + 3e-4 * np.arange(n) / RATE
    first, second = identify(allan_curve(np.stack([samples, ramp], axis=1), RATE))
    assert first.terms == ("quantisation", "white")
    assert first.values["quantisation"] == pytest.approx(0.02, rel=0.05)
    assert second.terms == ("white", "ramp")
    assert second.values["ramp"] == pytest.approx(3e-4, rel=0.05)


def test_flicker_is_found():
    rng, n = np.random.default_rng(106), 60_000
    k = np.arange(1, n)
    response = np.cumprod(np.append(1.0, (k - 0.5) / k))  # of (1 - z^-1)^(-1/2)
    spectrum = np.fft.rfft(response, 2 * n) * np.fft.rfft(rng.normal(size=n), 2 * n)
    flicker = 0.05 * np.fft.irfft(spectrum)[:n]  # two-sided density B² / (2 pi f) with B = 0.05
    (found,) = identify(allan_curve(simulated(6, n, white=0.1) + flicker, RATE))
    assert found.terms == ("white", "flicker")
    assert found.values["bias_instability"] == pytest.approx(0.05, rel=0.12)


def test_the_sum_of_the_parts_is_the_fit():
    noise = Noise(
        ("white", "gauss_markov"),
        {"white": 0.1, "gauss_markov_std": 0.2, "gauss_markov_time": 3.0},
        {}, {}, 0.0, 0, 0.0,
    )  # fmt: skip
    tau = np.geomspace(0.1, 100, 7)
    parts = noise.parts(tau)
    assert list(parts) == ["white", "gauss_markov"]
    np.testing.assert_allclose(sum(p**2 for p in parts.values()), noise.deviation(tau) ** 2)
    np.testing.assert_allclose(parts["gauss_markov"], gauss_markov_deviation(0.2, 3.0, tau))


def test_a_vibration_is_told_as_misfit():
    n = 60_000
    shaking = simulated(7, n, white=0.1) + 0.2 * np.sin(2 * np.pi * 0.4 * np.arange(n) / RATE)
    whole = allan_curve(shaking, RATE)
    assert identify(whole)[0].misfit > 0.05
    (later,) = identify(whole, shortest=20.0)
    assert later.values["white"] == pytest.approx(0.1, rel=0.15)


def test_only_candidates_are_looked_for():
    curve = allan_curve(simulated(8, 20_000, white=0.1, walk=0.02), RATE)
    (found,) = identify(curve, ("white", "flicker"))
    assert set(found.terms) <= {"white", "flicker"}
    assert set(found.support) == {"white", "flicker"}


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda c: identify(c, ("pink",)), "term 'pink' is unknown"),
        (lambda c: identify(c, ()), "no noise term"),
        (lambda c: identify(c, shortest=1e3), "too few to tell noises apart"),
        (lambda c: read_off(c, "peak"), "reading 'peak' is unknown"),
        (lambda c: identify(allan_curve(np.zeros(500), 1.0)), "constant"),
        (
            lambda c: identify(allan_curve(np.arange(500.0), 1.0, [1, 2, 4, 8, 16], overlapping=False)),
            "this one is not",
        ),
    ],
)
def test_refusals(rng, change, said):
    with pytest.raises(InputError, match=said):
        change(allan_curve(rng.normal(size=500), 10.0))


# --------------------------------------------------------------------------------------------- readings


def test_readings_of_a_curve_without_error():
    tau = np.unique(np.rint(np.geomspace(1, 1e6, 61))) / RATE
    noise = vector(white=0.1, bias_instability=0.01, random_walk=1e-4)
    deviation = np.sqrt(allan_parts(noise, tau).sum(axis=-1))
    falling = np.sqrt(allan_parts(vector(white=0.1), tau).sum(axis=-1))
    curve = curve_of(tau, deviation, falling)
    read = read_off(curve)
    np.testing.assert_allclose(read.white, 0.1, rtol=0.02)
    assert read.random_walk[0] == pytest.approx(1e-4, rel=0.1)
    assert np.isnan(read.random_walk[1])
    assert read.at_end.tolist() == [False, True]
    assert read.instability[0] == pytest.approx(0.01, rel=0.2)
    direct = read_off(curve, "direct")
    np.testing.assert_allclose(direct.instability / read.instability, IEEE_FACTOR)
    assert pytest.approx(0.664, abs=5e-4) == IEEE_FACTOR
    assert direct.instability[0] == deviation.min()


def test_published_gauss_markov_recovers_neither_time_nor_std():
    """The figures of its docstring."""
    tau = np.unique(np.rint(np.geomspace(1, 500 * 50, 400))) / 50
    truth = vector(white=0.1 / np.sqrt(50), gauss_markov_std=0.01, gauss_markov_time=300.0)
    curve = curve_of(tau, np.sqrt(allan_parts(truth, tau).sum(axis=-1)), rate=50.0)
    found = published_gauss_markov(curve)
    assert found.time[0] == pytest.approx(33, abs=1.0)
    assert found.std[0] == pytest.approx(0.0036, abs=5e-5)
    assert found.coefficient[0] == pytest.approx(np.exp(-1 / (found.time[0] * 50)))
    stationary = found.driving[0] / np.sqrt(1 - found.coefficient[0] ** 2)
    assert stationary == pytest.approx(found.std[0])


def test_every_parameter_has_a_term():
    assert [name for names in TERMS.values() for name in names] == list(PARAMETERS)
    assert len(PARAMETERS) == 7
