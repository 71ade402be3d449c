"""Real magnetometers: what repeats, what a maker's own program says, and what the earth's field must give."""

import numpy as np
import pytest

from pedjax.calibration import clouds, fitting
from pedjax.readers import read
from pedjax.recording import Stream


def present(data, name):
    path = data / name
    if not path.exists():
        pytest.skip(f"{name} is not in the folder that PEDJAX_DATA names")
    return path


def part(cloud, pick):
    return clouds.cloud(cloud.name, Stream(cloud.time[pick], cloud.field[pick]), None)


@pytest.fixture(scope="module")
def phone(data):
    """A phone's raw field on four days: the fit, of all and of parts of the samples."""

    def fits(day):
        cloud = clouds.read(str(present(data, f"magcal_pointclouds/nexus5_calib_mag_{day}")))
        half, every = len(cloud.field) // 2, np.arange(len(cloud.field))
        parts = {"all": every, "first": every[:half], "second": every[half:], "even": every[::2]}
        parts["odd"] = every[1::2]
        return {name: fitting.fit_cloud(part(cloud, pick)) for name, pick in parts.items()}

    return fits


@pytest.mark.slow
@pytest.mark.parametrize("day", ["d1", "d2", "d3", "d4"])
def test_a_phone_repeats_itself(phone, day):
    """Half axes over days within 0.3 µT. Hard iron over alternate samples within 0.1 µT, and over the halves
    of a day, in other attitudes, within 0.25 µT in x and y and 0.65 µT in z, where it is 410 µT."""
    found = phone(day)
    np.testing.assert_allclose(found["all"].diagnostics["half_axes_ut"], [45.4, 46.8, 49.7], atol=0.3)
    assert found["all"].diagnostics["residual_ut"] < 0.02 * found["all"].strength
    iron = {name: fit.calibration.hard_iron for name, fit in found.items()}
    assert np.abs(iron["even"] - iron["odd"]).max() < 0.1
    apart = np.abs(iron["first"] - iron["second"])
    assert (apart < [0.25, 0.25, 0.65]).all(), apart
    assert (np.abs(iron["all"] - [59.5, -63, 410.5]) < [2, 11, 2]).all()


@pytest.mark.slow
def test_a_phone_is_magnetised_anew_between_days(phone):
    """No calibration of another day serves it: y moves by 20 µT."""
    days = [phone(day)["all"].calibration.hard_iron for day in ("d1", "d2")]
    assert np.linalg.norm(days[0] - days[1]) > 10.0


def test_fxos8700_equals_magneto(data):
    """Bias and matrix that the program Magneto gives for the same samples."""
    path = present(data, "magcal_pointclouds/fxos8700_mag-readings.txt")
    fit = fitting.fit_cloud(clouds.read(str(path)), strength=53.29, refined=False)
    matrix = [
        [0.989575, -0.022220, 0.005152],
        [-0.022220, 0.989327, 0.022216],
        [0.005152, 0.022216, 1.045404],
    ]
    np.testing.assert_allclose(fit.calibration.hard_iron, [28.557458, -39.981060, -27.428035], atol=0.02)
    np.testing.assert_allclose(fit.calibration.matrix / np.linalg.det(fit.calibration.matrix) ** (1 / 3),
                               matrix / np.linalg.det(matrix) ** (1 / 3), atol=0.004)  # fmt: skip


def test_hmc5883l(data):
    h5py = pytest.importorskip("h5py")
    path = present(data, "magcal_pointclouds/hmc5883l_mpu6050/hmc5883l_compass.mat")
    with h5py.File(path) as file:
        (name,) = [key for key in file if not key.startswith("#")]
        table = np.asarray(file[name], float)
    table = table if table.shape[1] == 4 else table.T
    fit = fitting.fit_cloud(clouds.cloud("compass", Stream(table[:, 0], 100 * table[:, 1:]), None))
    np.testing.assert_allclose(fit.diagnostics["half_axes_ut"], [47.4, 54.5, 58.3], atol=0.2)
    np.testing.assert_allclose(fit.calibration.hard_iron, [-0.6, -10.5, 2.0], atol=0.2)
    assert fit.diagnostics["residual_ut"] < 0.006 * fit.strength


@pytest.mark.parametrize(
    ("trial", "most"), [("02_undisturbed_slow_rotation_B", 0.7), ("21_undisturbed_fast_combined", 1.1)]
)
def test_an_undisturbed_board_has_little_hard_iron(data, trial, most):
    """Calibrated by its makers. The fast trial moves through a field that differs by about 1 µT."""
    recording = read(present(data, f"broad/{trial}.mat"))
    cloud = clouds.of_recording(recording, "hand")
    thin = part(cloud, slice(None, None, 20))
    fit = fitting.fit_cloud(thin)
    assert np.linalg.norm(fit.calibration.hard_iron) < most
    assert 44.0 < fit.strength < 45.5
    assert fitting.choose(thin, None)[0] == "algebraic"


def test_a_magnet_put_on_meanwhile_is_noticed(data):
    recording = read(present(data, "broad/32_disturbed_attached_magnet_1cm.mat"))
    thin = part(clouds.of_recording(recording, "hand"), slice(None, None, 20))
    assert any("hard iron changed" in line for line in fitting.fit_cloud(thin).warnings)
