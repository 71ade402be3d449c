"""Named units with the figures of their data sheets and of the papers that walked with them.

Every number says where it is from:

- [S] data sheet, read for this file: Movella, MTi-300, May 2023 (the MTi-G-710 has the same inertial sensors
  and magnetometer), cdn.shopify.com/s/files/1/0716/3048/7831/files/MTi-300.pdf; InvenSense, PS-MPU-9250A-01,
  revision 1.0, 2014, github.com/kriswiner/MPU-9250/files/608940/MPU-9250-Datasheet.pdf; AKM, MS1356-E-02
  (AK8963, the magnetometer in the MPU-9250), 2013.
- [R] quoted at second hand, the source itself not read: LORD, 3DM-GX5-25, 8400-0093 revision N (in
  github.com/osrf/subt, submitted_models/marble_husky_sensor_config_3/specifications.md); KVH, DSP-1750
  manual (in github.com/bholder5/bit-matlab-sim, ADCS/estimation.m); KVH, P-1775, DS_P1775_IMU_0921, a later
  unit (canalgeomatics.com/wp-content/uploads/2022/07/kvh-p-1775-imu-datasheet.pdf); Olsson et al., Sensors
  2020, 3534, of the older MTw.
- [P] paper: Wang et al., Sensors 2018 (table 1, MTi-G-710); Munoz Diaz et al., Sensors 2017 (table 2, MTw
  beside a DSP-1750); Ma et al., Sensors 2018 (eight MPU-9250); Zhang et al. (MTw Awinda); the recordings of
  OpenShoe (3DM-GX2) and of Koroglu's gait-driven data set (3DM-GX5-25) for rates and ranges.
- [M] measured on the still starts of those recordings: median over axes of the spectral density at 20 to
  40 Hz (GX2) or 60 to 95 Hz (GX5), the foot's own trembling included.
- [A] assumed here; "kit choice" is a figure for which no sheet could be found, with what it is typical for.

Published densities are taken for two-sided as they stand; if the maker meant rms over root bandwidth, the
noise is up to sqrt(2) too high. A published tolerance is taken for three standard deviations [A], an in-run
bias stability for the peak of the Allan deviation of a Gauss-Markov bias, 0.617 of its standard deviation,
with a correlation time of 200 s for silicon [A] and ten times that for fibre (Munoz Diaz et al.: one order
longer). What nobody publishes, random walks and start-up drifts, is left out, and so are hard and soft iron,
which belong to the mounting.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from math import pi, sqrt
from typing import Any

import jax.numpy as jnp
from jax.typing import ArrayLike

from pedjax.errors import InputError, suggest
from pedjax.recording import STANDARD_GRAVITY
from pedjax.simulation.sensors import Clock, Imu, Magnetometer, Triad

_DEG = pi / 180
_HOUR = 3600.0
_G = STANDARD_GRAVITY
_MICRO_G = 1e-6 * STANDARD_GRAVITY
_ALLAN_PEAK = 0.617
_SILICON_TIME = 200.0
_GAUSS = 100.0  # microtesla
_MILLI_GAUSS = 0.1  # microtesla


def perfect(rate: float = 100.0) -> Imu:
    """No errors at all, at `rate` Hz."""
    return Imu(clock=Clock(rate=rate))


def xsens_mtw() -> Imu:
    """Xsens MTw Awinda, wireless, at 100 Hz [P: Zhang et al.]; Munoz Diaz et al. carry an older MTw."""
    return Imu(
        accelerometer=Triad(
            noise=200 * _MICRO_G,  # [A] kit choice, typical for silicon with a range of 16 g
            bias_std=0.03,  # [A] as the MTi of the same maker
            drift_std=100 * _MICRO_G / _ALLAN_PEAK,  # [A] kit choice: 0.1 mg, typical for the same
            drift_time=_SILICON_TIME,
            misalignment_std=0.1 * _DEG / 3,  # [A] kit choice: 0.1 deg, typical for units calibrated singly
            limit=160.0,  # [R] of the older MTw
            bandwidth=180.0,  # [A] kit choice, typical for wearable units that sample at about 1 kHz
        ),
        gyroscope=Triad(
            noise=0.01 * _DEG,  # [P] 0.1 deg/s per sample at 100 Hz, taken for white
            bias_std=0.1 * _DEG,  # [P] the size set in table 2
            drift_std=10 * _DEG / _HOUR / _ALLAN_PEAK,  # [A] kit choice: 10 deg/h, as the MTi [S]
            drift_time=_SILICON_TIME,
            misalignment_std=0.1 * _DEG / 3,  # [A] kit choice: 0.1 deg, as above
            limit=2000 * _DEG,  # [A] kit choice, typical for wearable units; the older MTw 21 rad/s [R]
            bandwidth=180.0,  # [A] kit choice, as above
        ),
        magnetometer=Magnetometer(
            Triad(
                noise=0.2 * _MILLI_GAUSS,  # [A] kit choice, near the 0.015 microtesla [P] taken for a density
                limit=1.9 * _GAUSS,  # [A] kit choice, typical for magnetoresistive compass chips
            )
        ),
        clock=Clock(rate=100.0),
    )


def mti_g_710() -> Imu:
    """Xsens MTi-G-710 at 100 Hz [P: Wang et al.]."""
    return Imu(
        accelerometer=Triad(
            noise=80 * _MICRO_G,  # [P] typical, 150 at most; 60 in [S] of 2023
            bias_std=0.03,  # [P] bias repeatability, typical; 0.05 at most
            drift_std=15 * _MICRO_G / _ALLAN_PEAK,  # [S] 15 microg
            drift_time=_SILICON_TIME,
            limit=20 * _G,  # [S]
            bandwidth=375.0,  # [S]
        ),
        gyroscope=Triad(
            noise=0.01 * _DEG,  # [P] and [S] typical; 0.015 at most [P]
            bias_std=0.2 * _DEG,  # [P] bias repeatability, typical; 0.5 at most
            drift_std=10 * _DEG / _HOUR / _ALLAN_PEAK,  # [S] 10 deg/h
            drift_time=_SILICON_TIME,
            g_sensitivity_std=0.003 * _DEG / _G / 3,  # [S] 0.003 deg/s/g, calibrated
            limit=450 * _DEG,  # [S]; a quick foot exceeds it
            bandwidth=415.0,  # [S]
        ),
        magnetometer=Magnetometer(
            Triad(
                noise=0.5 * _MILLI_GAUSS / sqrt(100.0),  # [S] 0.5 mG rms in all, [A] per sample at 100 Hz
                limit=8 * _GAUSS,  # [S]
                resolution=0.25 * _MILLI_GAUSS,  # [S]
            )
        ),
        clock=Clock(rate=100.0),
    )


def mpu_9250() -> Imu:
    """InvenSense MPU-9250 at 400 Hz [P: Ma et al.] in its widest ranges [A], as it leaves the factory; what
    a calibration leaves of it is `calibrated(mpu_9250(), 0.05)` or so."""
    return Imu(
        accelerometer=Triad(
            noise=300 * _MICRO_G,  # [S]
            bias_std=jnp.array([0.060, 0.060, 0.080]) * _G / 3,  # [S] 60 mg, z 80 mg
            drift_std=50 * _MICRO_G / _ALLAN_PEAK,  # [A]
            drift_time=_SILICON_TIME,
            temperature_std=0.0015 * _G / 3,  # [S] 1.5 mg/K
            scale_std=0.03 / 3,  # [S] 3 %
            misalignment_std=0.02 / 3,  # [S] cross-axis 2 %
            limit=16 * _G,  # [S]
            bandwidth=94.0,  # [S] filter setting 2, for which the sheet gives the total noise
            resolution=_G / 2048,  # [S]
        ),
        gyroscope=Triad(
            noise=0.01 * _DEG,  # [S]
            bias_std=5 * _DEG / 3,  # [S] 5 deg/s
            drift_std=20 * _DEG / _HOUR / _ALLAN_PEAK,  # [A]
            drift_time=_SILICON_TIME,
            temperature_std=30 * _DEG / 65 / 3,  # [S] 30 deg/s from 25 to -40 degrees, [A] in a straight line
            scale_std=0.03 / 3,  # [S] 3 %
            misalignment_std=0.02 / 3,  # [S] cross-axis 2 %
            limit=2000 * _DEG,  # [S]
            bandwidth=92.0,  # [S] filter setting 2
            resolution=_DEG / 16.4,  # [S]
        ),
        magnetometer=Magnetometer(
            Triad(
                noise=0.04,  # [A] 0.4 microtesla in a sample at 100 Hz; not in the sheet
                limit=4912.0,  # [S]
                resolution=0.15,  # [S]
            )
        ),
        clock=Clock(rate=400.0),
    )


def imu_array_8() -> Imu:
    """The mean of eight MPU-9250 on one board, four above and four below [P: Ma et al.]."""
    return averaged(mpu_9250(), 8)


def kvh_dsp_1750() -> Imu:
    """KVH DSP-1750 fibre gyroscope at 100 Hz [A], with the accelerometer of KVH's 1750 unit; no magnetometer,
    so that its triad is perfect: Munoz Diaz et al. emulate the field."""
    return Imu(
        accelerometer=Triad(
            noise=120 * _MICRO_G,  # [A] kit choice, typical for tactical silicon; 34 in the P-1775 [R]
            bias_std=0.002 * _G / 3,  # [A] kit choice: 2 mg, typical for tactical silicon
            drift_std=50 * _MICRO_G / _ALLAN_PEAK,  # [A] kit choice, as above; 15 microg in the P-1775 [R]
            drift_time=_SILICON_TIME,
            limit=10 * _G,  # [A] kit choice: the P-1775 [R] comes with 10 g too
            bandwidth=200.0,  # [A]
        ),
        gyroscope=Triad(
            noise=0.012 * _DEG / sqrt(_HOUR),  # [R] 0.012 deg/sqrt(h) at most, P-1775
            # The DSP-1750 manual [R] gives 10 deg/h, but [P] integrates less than 1 degree in an hour.
            bias_std=2 * _DEG / _HOUR / 3,  # [A] kit choice: 2 deg/h, between the two
            drift_std=0.05 * _DEG / _HOUR / _ALLAN_PEAK,  # [R] 0.05 deg/h, DSP-1750 and P-1775 alike
            drift_time=10 * _SILICON_TIME,
            scale_std=500e-6 / 3,  # [A] 500 ppm
            limit=490 * _DEG,  # [R] P-1775
            bandwidth=440.0,  # [A] kit choice, typical for fibre gyroscopes read at 1 kHz
        ),
        clock=Clock(rate=100.0),
    )


def gx2() -> Imu:
    """MicroStrain 3DM-GX2, 18 g and 1200 deg/s, at 250 Hz [P: OpenShoe], in the sole of a shoe."""
    return Imu(
        accelerometer=Triad(
            noise=8.0e-4,  # [M]
            bias_std=0.005 * _G,  # [A] kit choice: 5 mg, typical for silicon units of its generation
            drift_std=50 * _MICRO_G / _ALLAN_PEAK,  # [A]
            drift_time=_SILICON_TIME,
            scale_std=0.008,  # [M] 1.008 g at rest
            limit=18 * _G,  # [P]
            bandwidth=55.0,  # [M] where the noise falls off, which the unit filters with the signal
        ),
        gyroscope=Triad(
            noise=4.3e-4,  # [M] 0.025 deg/s/sqrt(Hz)
            bias_std=0.2 * _DEG,  # [A] kit choice, typical for the same
            drift_std=50 * _DEG / _HOUR / _ALLAN_PEAK,  # [A]
            drift_time=_SILICON_TIME,
            limit=1200 * _DEG,  # [P]
            bandwidth=55.0,  # [M]
        ),
        magnetometer=Magnetometer(
            Triad(
                noise=0.006,  # [M]
                limit=1.2 * _GAUSS,  # [A] kit choice, about twice the strongest field of the earth
            )
        ),
        clock=Clock(rate=250.0),
    )


def gx5() -> Imu:
    """MicroStrain 3DM-GX5-25, 20 g and 900 deg/s, at 200 Hz [P: Koroglu]."""
    return Imu(
        accelerometer=Triad(
            noise=5.2e-4,  # [M] 53 microg/sqrt(Hz); [R] 20, its range not named
            bias_std=0.002 * _G,  # [A] kit choice: 2 mg, typical for a calibrated industrial unit
            drift_std=40 * _MICRO_G / _ALLAN_PEAK,  # [A] kit choice: 0.04 mg, typical for the same
            drift_time=_SILICON_TIME,
            scale_std=0.0003,  # [A] kit choice: 0.03 %, typical for the same
            misalignment_std=0.05 * _DEG / 3,  # [A] kit choice: 0.05 deg, typical for the same
            limit=20 * _G,  # [A] the least option that holds the 169 m/s^2 recorded [P]
            bandwidth=225.0,  # [A] kit choice, far above what a foot at 200 Hz shows
        ),
        gyroscope=Triad(
            noise=0.005 * _DEG,  # [R]; [M] 0.003
            bias_std=0.04 * _DEG,  # [A] kit choice, typical for a calibrated industrial unit
            drift_std=8 * _DEG / _HOUR / _ALLAN_PEAK,  # [A] kit choice: 8 deg/h, typical for the same
            drift_time=_SILICON_TIME,
            scale_std=0.0005,  # [A] kit choice: 0.05 %, typical for the same
            misalignment_std=0.05 * _DEG / 3,  # [A] kit choice: 0.05 deg, typical for the same
            limit=900 * _DEG,  # [A] the least option that holds the 511 deg/s recorded [P]
            bandwidth=250.0,  # [A] kit choice, far above what a foot at 200 Hz shows
        ),
        magnetometer=Magnetometer(
            Triad(
                noise=0.4 * _MILLI_GAUSS,  # [A] kit choice, typical for magnetoresistive compass chips
                limit=8 * _GAUSS,  # [A] kit choice, as the MTi [S]
            )
        ),
        clock=Clock(rate=200.0),
    )


PRESETS: dict[str, Callable[[], Imu]] = {
    preset.__name__: preset
    for preset in (perfect, xsens_mtw, mti_g_710, mpu_9250, imu_array_8, kvh_dsp_1750, gx2, gx5)
}
"""What makes each unit, by name."""


def presets() -> dict[str, Imu]:
    """Every unit by name."""
    return {name: make() for name, make in PRESETS.items()}


def preset(name: str) -> Imu:
    """The unit of that name; an unknown one is an `InputError` with a suggestion."""
    if name not in PRESETS:
        raise InputError(f"sensor preset '{name}' is unknown{suggest(name, PRESETS)}")
    return PRESETS[name]()


_RANDOM = ("noise", "walk", "drift_std")
_PER_UNIT = (
    "bias_std",
    "startup_std",
    "temperature_std",
    "scale_std",
    "misalignment_std",
    "g_sensitivity_std",
)


def averaged(imu: Imu, count: int) -> Imu:
    """The mean of `count` such units with errors of their own: all that is random falls by sqrt(count), and
    the least step by `count`. Fixed errors, limit, bandwidth and clock stay."""
    if count < 1:
        raise InputError(f"the mean of {count} units does not exist")

    def mean(triad: Triad) -> Triad:
        shrunk = _scaled(triad, (*_RANDOM, *_PER_UNIT), 1 / sqrt(count))
        return _scaled(shrunk, ("resolution",), 1 / count)

    return _each(imu, mean)


def calibrated(imu: Imu, left: ArrayLike) -> Imu:
    """The unit after a calibration that leaves the part `left` of every constant drawn error (biases, scale,
    misalignment, g-sensitivity, temperature); noise and drift stay."""
    return _each(imu, lambda triad: _scaled(triad, _PER_UNIT, left))


def _scaled(triad: Triad, names: tuple[str, ...], factor: ArrayLike) -> Triad:
    changes: dict[str, Any] = {name: jnp.multiply(getattr(triad, name), factor) for name in names}
    return replace(triad, **changes)


def _each(imu: Imu, change: Callable[[Triad], Triad]) -> Imu:
    return replace(
        imu,
        accelerometer=change(imu.accelerometer),
        gyroscope=change(imu.gyroscope),
        magnetometer=replace(imu.magnetometer, triad=change(imu.magnetometer.triad)),
    )
