"""ROC of a stance detector over recordings."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import jax.numpy as jnp
import numpy as np

from pedjax import parameters
from pedjax.detectors import stance
from pedjax.evaluation.roc import Roc, roc
from pedjax.packing import nominal_rate
from pedjax.recording import Inertial


def detector_roc(
    params: Any, detector: str, samples: Sequence[Inertial], labels: Sequence[np.ndarray]
) -> Roc:
    """ROC of a detector, with the window and sigmas of `params.stance`, over all samples together."""
    chosen = parameters.replace(params, {"stance.detector": detector}).stance
    dtype = jnp.result_type(float)
    found = [
        np.asarray(
            stance.statistic(
                parameters.cast(chosen, dtype),
                jnp.asarray(s.specific_force, dtype),
                jnp.asarray(s.angular_rate, dtype),
                nominal_rate(s),
                params.gravity,
            )
        )
        for s in samples
    ]
    return roc(np.concatenate(found), np.concatenate(labels))
