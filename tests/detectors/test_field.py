"""Seven field detectors against naive loops, and what their statistics are known to do."""

from functools import lru_cache

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.stats import chi2, kstest, ncx2

from pedjax import parameters
from pedjax.detectors import field
from pedjax.detectors.field import FIELD_DETECTORS, FieldParameters, Look
from pedjax.gates import gate
from tests.reference import field as naive

COUNT, NORTH = 23, np.pi / 2
MUNICH = np.array([1.2, 21.2, -43.3])
THIRD = 0.3 * np.pi / 180  # rad
PUBLISHED = (0.067, 0.054, 0.535)
BOTH = (True, False)
SETTINGS = {
    "qsf": [{"form": f, "per": p} for f in ("mean", "energy") for p in ("step", "second")],
    "qmd": [{"form": f, "per": p} for f in ("mean", "energy") for p in ("step", "second")],
    "magyq": [{}],
    "iqsf": [{"absolute": a, "per": p} for a in BOTH for p in ("step", "second")],
    "ma": [
        {"theta": t, "absolute": a, "form": f, "per": p}
        for t in ("rate", "level")
        for a in BOTH
        for f in ("mean", "energy")
        for p in ("step", "second")
    ],
    "aiez": [
        {"yaw_variance": v, "form": f, "per": p}
        for v in BOTH
        for f in ("energy", "mean")
        for p in ("step", "second")
    ],
    "vector": [{}],
}


def chosen(detector, steps=3, **own):
    settings = {f"{detector}.{name}": value for name, value in own.items()}
    return parameters.replace(FieldParameters(), {"detector": detector, "window": steps, **settings})


def windows(looks, steps):
    """Windows of `field (K, 3)`, `yaw`, `time`, `variance (K,)`, side by side in lanes `(K - N,)`."""
    b, *rest = (jnp.asarray(x) for x in looks)
    stop = len(b) - steps
    return tuple(Look(b[k : k + stop].T, *(x[k : k + stop] for x in rest)) for k in range(steps + 1))


@jax.jit
def ratios(p, window, north=NORTH):
    """Log of statistic over threshold."""
    return field.log_ratio(p, window, jnp.asarray(north, window[0].yaw.dtype))


@pytest.fixture(scope="module")
def looks():
    rng = np.random.default_rng(31)
    b = MUNICH + np.cumsum(rng.normal(0, 4.0, (COUNT, 3)), axis=0)
    b[11, :2] *= -1  # through the cut of the angle
    yaw = np.cumsum(rng.normal(0, 0.9, COUNT))
    return b, yaw, np.cumsum(rng.uniform(0.9, 1.4, COUNT)), rng.uniform(0.0, 0.02, COUNT)


def expected(p, looks, north=NORTH):
    """The statistic over its threshold, from loops."""
    own, n = getattr(p, p.detector), p.window
    *looks, variance = looks
    if p.detector in ("qsf", "qmd"):
        return naive.qsf(*looks, n, own.sigma_strength, own.form, own.per) / own.threshold
    if p.detector == "magyq":
        return np.maximum(*naive.magyq(*looks, n, own.variance, own.outlier))
    if p.detector == "iqsf":
        found = naive.iqsf(*looks, n, own.sigma_heading, own.sigma_strength, own.absolute, own.per)
        return found / own.threshold
    if p.detector == "ma":
        sigmas = (own.sigma_heading, own.sigma_inclination, own.sigma_strength)
        return naive.ma(*looks, n, sigmas, own.theta, own.absolute, own.form, own.per, north) / own.threshold
    if p.detector == "aiez":
        sigmas = (own.sigma_heading, own.sigma_strength)
        found = naive.aiez(*looks, variance, n, sigmas, own.yaw_variance, own.form, own.per, north)
        return found / own.threshold
    worst, largest = naive.vector(*looks, n, own.sigma_field, own.sigma_tilt, own.sigma_yaw)
    return worst / np.asarray(
        field.noncentral_quantile(jnp.asarray(own.false_alarm), 3.0, own.change**2 / largest)
    )


@jax.jit
def all_ratios(choices, window, north):
    return [field.log_ratio(p, window, north) for p in choices]


@pytest.mark.parametrize("steps", [1, 3, 5])
def test_detectors_equal_loops(looks, steps):
    choices = [
        chosen(d, steps, **own) for d, each in SETTINGS.items() for own in (each if steps == 3 else each[:1])
    ]
    found = all_ratios(choices, windows(looks, steps), 1.3)
    for p, ratio in zip(choices, found, strict=True):
        np.testing.assert_allclose(
            np.exp(ratio), expected(p, looks, 1.3)[steps:], rtol=1e-10, err_msg=str(getattr(p, p.detector))
        )


@pytest.mark.parametrize("detector", FIELD_DETECTORS)
def test_lanes_equal_one_by_one_and_thresholds_spread(looks, detector):
    window = windows(looks, 3)
    names = {"magyq": ("variance", "outlier"), "vector": ("false_alarm",)}.get(detector, ("threshold",))
    scales = np.array([0.2, 0.5, 1.0])[:, None]
    own = chosen(detector)
    lanes = parameters.with_leaves(
        own,
        {f"{detector}.{n}": jnp.asarray(parameters.get(own, f"{detector}.{n}") * scales) for n in names},
    )
    together = np.asarray(ratios(lanes, window))
    assert together.shape == (3, COUNT - 3)
    for i, scale in enumerate(scales[:, 0]):
        changed = {f"{detector}.{n}": parameters.get(own, f"{detector}.{n}") * scale for n in names}
        alone = parameters.replace(own, changed)
        np.testing.assert_allclose(together[i], ratios(alone, window), rtol=1e-12, atol=1e-12)
        one = jax.tree.map(lambda x: x[..., 5], window)
        np.testing.assert_allclose(together[i, 5], ratios(alone, one), rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize("detector", FIELD_DETECTORS)
def test_single_precision(looks, detector):
    p = chosen(detector)
    double = ratios(p, windows(looks, 3))
    single = ratios(parameters.cast(p, jnp.float32), windows([np.asarray(x, np.float32) for x in looks], 3))
    assert single.dtype == jnp.float32
    np.testing.assert_allclose(single, double, atol=2e-4)


@pytest.mark.parametrize("absolute", BOTH)
def test_a_mean_never_exceeds_the_energy_of_its_window(looks, absolute):
    """T_A <= N T_B (Cauchy and Schwarz), with equality where every change is the same."""
    for steps in (1, 3, 5):
        mean, energy = (
            np.asarray(ratios(chosen("ma", steps, form=f, absolute=absolute), windows(looks, steps)))
            for f in ("mean", "energy")
        )
        assert (mean <= energy + np.log(steps) + 1e-12).all()
    turn = 0.1 * np.arange(COUNT)
    even = np.stack([20 * np.cos(turn), 20 * np.sin(turn), 0 * turn], 1), turn, 1.0 + turn, 0 * turn
    mean, energy = (
        ratios(chosen("ma", form=f, absolute=absolute), windows(even, 3)) for f in ("mean", "energy")
    )
    np.testing.assert_allclose(mean, energy + np.log(3), atol=1e-9)


def drawn(count, steps, seed):
    """Windows in lanes whose changes of azimuth, inclination and strength are white, of Ma's sigmas."""
    rng = np.random.default_rng(seed)
    azimuth, dip, size = (
        first + np.cumsum(rng.normal(0, sigma, (steps + 1, count)), axis=0)
        for first, sigma in zip((0.3, 0.6, 48.0), PUBLISHED, strict=True)
    )
    b = np.stack(
        [size * np.cos(dip) * np.cos(azimuth), size * np.cos(dip) * np.sin(azimuth), -size * np.sin(dip)]
    )
    zero = jnp.zeros(count)
    return tuple(Look(jnp.asarray(b[:, k]), zero, zero, zero) for k in range(steps + 1))


def test_absolute_values_more_than_double_the_mean_of_the_statistic():
    """Folded, the mean of a channel of three steps is 1 + 4/pi = 2.27; signed, 1, and three are a chi^2."""
    window = drawn(20_000, 3, seed=11)
    folded, signed = (
        np.exp(np.asarray(ratios(chosen("ma", absolute=a, threshold=1.0), window))) for a in (True, False)
    )
    assert folded.mean() / 3 == pytest.approx(1 + 4 / np.pi, rel=0.02)
    assert signed.mean() / 3 == pytest.approx(1.0, rel=0.02)
    assert kstest(signed, chi2(3).cdf).pvalue > 0.01
    energy = np.exp(np.asarray(ratios(chosen("ma", form="energy", threshold=1.0), window)))
    assert kstest(3 * energy, chi2(9).cdf).pvalue > 0.01
    assert np.quantile(folded, 0.99) < 21 < np.quantile(folded, 0.999)  # 170 is published


def seen(rng, places, sigma=0.1, tilt=THIRD, yaw=THIRD):
    """Looks `(3, L)` at fields `(N + 1, 3, L)` with independent noise, turned anew between any two."""
    found, drift = [], np.zeros((3, places.shape[2]))
    for k, b in enumerate(places):
        if k:
            drift = drift + rng.normal(0, 1, drift.shape) * np.array([tilt, tilt, yaw])[:, None]
        found.append(b + np.cross(drift, b, axis=0) + rng.normal(0, sigma, b.shape))
    zero = jnp.zeros(places.shape[2])
    return tuple(Look(jnp.asarray(b), zero, zero, zero) for b in found)


def statistic(p, window):
    """The vector detector's own statistic."""
    own = p.vector
    b = sum(look.field for look in window) / len(window)
    largest = 2 * own.sigma_field**2 + jnp.sum(b * b, 0) * jnp.maximum(own.sigma_tilt, own.sigma_yaw) ** 2
    limit = field.noncentral_quantile(jnp.asarray(own.false_alarm), 3.0, own.change**2 / largest)
    return np.asarray(jnp.exp(ratios(p, window)) * limit)


@pytest.mark.parametrize("angles", [(0.3, 0.3), (0.2, 0.8)])
def test_the_same_field_is_a_chi_square_of_three(angles):
    tilt, yaw = np.radians(angles)
    p = chosen("vector", 1, sigma_tilt=tilt, sigma_yaw=yaw)
    same = np.broadcast_to(MUNICH[None, :, None], (2, 3, 8000))
    found = statistic(p, seen(np.random.default_rng(3), same, tilt=tilt, yaw=yaw))
    assert kstest(found, chi2(3).cdf).pvalue > 0.01


def test_a_change_of_the_length_passes_no_more_often_than_agreed():
    """One change of `change` in any direction and step: at most the false alarm, about it in the worst."""
    count, rng = 20_000, np.random.default_rng(7)
    for false_alarm in (0.1, 0.3):
        p = chosen("vector", 3, false_alarm=false_alarm, change=1.0, sigma_tilt=THIRD, sigma_yaw=THIRD)
        way = rng.normal(0, 1, (3, count))
        along = MUNICH / np.linalg.norm(MUNICH)
        worst = way - along[:, None] * (along @ way)  # where a turn between two looks tells most
        passed = []
        for direction in (way, worst, np.broadcast_to(along[:, None], way.shape)):
            step = direction / np.linalg.norm(direction, axis=0)
            when = rng.integers(1, 4, count)
            places = np.stack([MUNICH[:, None] + (k >= when) * step for k in range(4)])
            passed.append(float(np.mean(np.asarray(ratios(p, seen(rng, places))) < 0)))
        allowed = false_alarm + 3 * np.sqrt(false_alarm / count)
        assert passed[0] < allowed
        assert passed[1] < allowed
        assert passed[1] > 0.85 * false_alarm
        assert passed[2] < 0.01 * false_alarm


def test_quantile_of_the_noncentral_chi_square():
    """Within 2 % of the value from a tenth on, and everywhere within 0.7 % of the whole probability; lower
    down the value is too small, on the safe side (by 42 % for one in a hundred)."""
    probability, noncentrality = np.meshgrid(np.linspace(0.01, 0.99, 99), np.linspace(0, 50, 101))
    found = np.asarray(jax.jit(field.noncentral_quantile, static_argnums=1)(probability, 3.0, noncentrality))
    away = found / ncx2.ppf(probability, 3, np.maximum(noncentrality, 1e-12)) - 1
    reached = ncx2.cdf(found, 3, np.maximum(noncentrality, 1e-12))
    assert np.abs(away[probability > 0.095]).max() < 0.02
    assert away.max() < 0.02
    assert away.min() > -0.42
    assert np.abs(reached - probability).max() < 0.007
    far = np.asarray(field.noncentral_quantile(jnp.asarray(0.1), 3.0, jnp.asarray([50.0, 100.0, 1e4])))
    np.testing.assert_allclose(far, ncx2.ppf(0.1, 3, [50.0, 100.0, 1e4]), rtol=3e-4)


def test_normal_quantile_and_rising_limits():
    assert field.normal_quantile(jnp.asarray(0.975)) == pytest.approx(1.959964, abs=1e-6)
    grid = jnp.linspace(0.02, 0.98, 49)
    assert (jnp.diff(field.noncentral_quantile(grid, 3.0, jnp.asarray(4.0))) > 0).all()
    assert (jnp.diff(field.noncentral_quantile(jnp.asarray(0.1), 3.0, jnp.linspace(0, 80, 99))) > 0).all()


def passes(detector, b, yaw=None, variance=0.0, **own):
    """Whether each window of looks a second apart is quasi-static."""
    b = np.asarray(b, float)
    count = len(b)
    yaw = np.zeros(count) if yaw is None else yaw
    looks = b, yaw, 1.0 * np.arange(count), np.full(count, variance)
    return np.asarray(ratios(chosen(detector, 3, **own), windows(looks, 3))) < 0


def rotating(angle):
    """A field of constant strength and inclination whose azimuth is `angle (K,)`."""
    return np.stack([21.0 * np.cos(angle), 21.0 * np.sin(angle), np.full(len(angle), -43.0)], axis=1)


def test_strength_alone_is_blind_to_a_field_that_turns():
    turning = rotating(0.9 * np.arange(8))
    for blind in ("qsf", "qmd", "magyq"):
        assert passes(blind, turning).all(), blind
    for other in ("ma", "vector", "iqsf"):
        assert not passes(other, turning).any(), other


def test_a_walker_who_turns_is_refused_by_iqsf_alone():
    same = np.tile(MUNICH, (8, 1))
    yaw = 0.6 * np.arange(8)
    assert not passes("iqsf", same, yaw).any()
    assert passes("iqsf", same, 0 * yaw).all()
    for other in ("ma", "qsf", "qmd", "magyq", "vector"):
        assert passes(other, same, yaw).all(), other


def test_an_excursion_that_returns_is_hidden_by_signs():
    there_and_back = rotating(np.array([0.0, 0.9, -0.9, 0.0]))
    assert passes("ma", there_and_back, absolute=False).all()
    assert not passes("ma", there_and_back, absolute=True).any()
    assert not passes("ma", there_and_back, absolute=False, form="energy", threshold=100.0).any()


def test_the_level_tells_a_steady_field_that_points_elsewhere():
    away = rotating(np.full(6, 0.2))
    assert passes("ma", away, theta="rate").all()
    assert not passes("ma", away, theta="level").any()
    assert passes("ma", rotating(np.full(6, NORTH + 0.05)), theta="level").all()


def test_the_level_passes_as_far_as_the_yaw_is_unsure():
    """A steady field 0.3 rad off north is over 4 sigma of 0.07 rad, and one of a yaw unsure by 0.3 rad."""
    away = rotating(np.full(6, NORTH + 0.3))
    assert not passes("aiez", away).any()
    assert passes("aiez", away, variance=0.09).all()
    assert not passes("aiez", away, variance=0.09, yaw_variance=False).any()
    assert passes("aiez", rotating(np.full(6, NORTH + 0.1))).all()


def test_the_difference_of_headings_has_no_step_at_half_a_turn():
    """On either side of south, where the difference jumps from one end to the other, it counts the same."""
    south = rotating(-NORTH + np.array([1e-6, -1e-6, 1e-6, -1e-6]))
    looks = (south, np.zeros(4), 1.0 * np.arange(4), np.zeros(4))
    found = ratios(chosen("aiez"), windows(looks, 3))
    p = chosen("aiez").aiez
    np.testing.assert_allclose(np.exp(found) * p.threshold, (np.pi / p.sigma_heading) ** 2, rtol=1e-5)


NUMBERS = {
    "qsf": ("threshold", "sigma_strength"),
    "qmd": ("threshold", "sigma_strength"),
    "magyq": ("variance", "outlier"),
    "iqsf": ("threshold", "sigma_heading", "sigma_strength"),
    "ma": ("threshold", "sigma_heading", "sigma_inclination", "sigma_strength"),
    "aiez": ("threshold", "sigma_heading", "sigma_strength"),
    "vector": ("false_alarm", "change", "sigma_field", "sigma_tilt", "sigma_yaw"),
}


def softly(p, values, window, width):
    """Mean weight of the windows, by some leaves."""
    p = parameters.with_leaves(p, values)
    return jnp.mean(gate(field.log_ratio(p, window, jnp.asarray(NORTH)), width))


@lru_cache
def slopes():
    return jax.jit(jax.value_and_grad(softly, (1, 2)))


@pytest.mark.parametrize("detector", FIELD_DETECTORS)
def test_gradients_equal_differences_through_the_soft_gate(looks, detector):
    apart = {"sigma_yaw": 0.003} if detector == "vector" else {}  # the larger of two equal sigmas has a kink
    p, window = parameters.cast(chosen(detector, 3, **apart), float), windows(looks, 3)
    values = {f"{detector}.{n}": jnp.asarray(parameters.get(p, f"{detector}.{n}")) for n in NUMBERS[detector]}
    width = jnp.asarray(2.0)
    _, (gradient, by_window) = slopes()(p, values, window, width)

    def value(*given):
        return slopes()(*given)[0]

    for name, x in values.items():
        h = 1e-5 * x
        difference = (
            value(p, {**values, name: x + h}, window, width)
            - value(p, {**values, name: x - h}, window, width)
        ) / (2 * h)
        assert gradient[name] == pytest.approx(float(difference), rel=2e-5, abs=1e-13), name
        assert difference != 0.0 or detector == "magyq", name
    h = 1e-5
    for lane in (0, 7):
        up, down = (
            (window[0], window[1]._replace(field=window[1].field.at[0, lane].add(s)), *window[2:])
            for s in (h, -h)
        )
        difference = (value(p, values, up, width) - value(p, values, down, width)) / (2 * h)
        assert by_window[1].field[0, lane] == pytest.approx(float(difference), rel=2e-5, abs=1e-10)
    if detector == "aiez":
        up, down = (
            (*window[:3], window[3]._replace(variance=window[3].variance.at[7].add(s))) for s in (h, -h)
        )
        difference = (value(p, values, up, width) - value(p, values, down, width)) / (2 * h)
        assert difference != 0.0
        assert by_window[3].variance[7] == pytest.approx(float(difference), rel=2e-5, abs=1e-10)


FIELDS = {
    "nothing": np.zeros((4, 3)),
    "straight down": np.tile([0.0, 0.0, -48.0], (4, 1)),
    "straight up": np.tile([0.0, 0.0, 48.0], (4, 1)),
    "the same": np.tile(MUNICH, (4, 1)),
    "nothing, then one": np.array([[0, 0, 0], [0, 0, 0], [0, 0, 0], MUNICH]),
    "absurd": 1e4 * np.array([[1, 0, 0], [0, 1, 0], [-1, 0, 0], [0, 0, 1]]),
}


@pytest.mark.parametrize("dtype", [jnp.float32, jnp.float64])
@pytest.mark.parametrize("detector", FIELD_DETECTORS)
def test_dead_fields_have_finite_statistics_and_gradients(detector, dtype):
    p = parameters.cast(chosen(detector), dtype)
    values = {f"{detector}.{n}": parameters.get(p, f"{detector}.{n}") for n in NUMBERS[detector]}
    given = np.stack(list(FIELDS.values()), axis=-1).astype(dtype)
    lanes = given[..., np.arange(COUNT - 3) % len(FIELDS)]
    zero = jnp.zeros(lanes.shape[-1], dtype)
    window = tuple(Look(jnp.asarray(b), zero, zero, zero) for b in lanes)
    assert np.isfinite(ratios(p, window)).all()
    for width in (0.0, 0.5):
        found = slopes()(p, values, window, jnp.asarray(width, dtype))
        for x in jax.tree.leaves(found):
            assert np.isfinite(x).all()


@pytest.mark.parametrize("detector", FIELD_DETECTORS)
def test_a_field_that_is_not_a_number_is_not_quasi_static(looks, detector):
    b, *rest = (x.copy() for x in looks)
    b[6, 1] = np.nan
    found = np.asarray(gate(ratios(chosen(detector), windows((b, *rest), 3)), 0.0))
    assert (found[3:7] == 0).all()


def test_padding_two_looks_at_one_time_is_finite(looks):
    b, yaw, time, variance = looks
    window = windows((b, yaw, 0 * time, variance), 3)
    for detector in ("ma", "iqsf", "qsf", "aiez"):
        assert np.isfinite(ratios(chosen(detector, per="second"), window)).all()
