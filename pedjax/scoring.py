"""A track against what is known of the walk: the score."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

import jax
import numpy as np

from pedjax.errors import InputError, suggest
from pedjax.evaluation.heading import heading_rms
from pedjax.evaluation.landmarks import ALIGNMENTS, align, landmark_errors
from pedjax.recording import Recording
from pedjax.running import Track
from pedjax.walks import attitudes_of, points_of, reference_of


@dataclass(frozen=True)
class Score:
    """Errors of one track in m after `alignment`, at `count` landmarks (or truth samples).

    `percent_of_distance` is the final horizontal error over the distance walked. `armse_m` is the mean
    over points of the RMS over x and y. `heading_rms_deg` needs a truth with orientation; a constant
    offset is taken off. Values that the landmarks cannot give are None.
    """

    count: int
    alignment: str
    rms_2d_m: float | None
    rms_3d_m: float | None
    mean_2d_m: float | None
    max_2d_m: float | None
    final_2d_m: float | None
    percent_of_distance: float | None
    armse_m: float | None
    rms_height_m: float | None = None
    heading_rms_deg: float | None = None
    warnings: tuple[str, ...] = ()

    def as_dict(self) -> dict[str, Any]:
        """Plain values for JSON, without what is not known beyond the standard fields."""
        optional = ("rms_height_m", "heading_rms_deg", "warnings")
        return {k: v for k, v in asdict(self).items() if k not in optional or v not in (None, ())}


def choose_alignment(position: np.ndarray) -> str:
    """`yaw_translation` where three or more points spread over a metre, else `yaw` (closures)."""
    known = position[np.isfinite(position[:, :2]).all(axis=1), :2]
    if len(known) >= 3 and np.linalg.norm(known - known[0], axis=1).max() > 1.0:
        return "yaw_translation"
    return "yaw"


def aligned(track: Track, recording: Recording, alignment: str = "auto") -> np.ndarray:
    """The whole track's positions `(T, 3)` laid on the landmarks by the alignment of `evaluate`."""
    index, position = points_of(recording, track.time, None, track.sensor)
    if len(index) == 0 or alignment == "none":
        return track.position
    how = choose_alignment(position) if alignment == "auto" else alignment
    estimate = np.asarray(track.position, float)
    # the landmarks fix the alignment; the rest of the track rides along as points of weight zero
    everything = np.concatenate([estimate[index], estimate])
    padding = np.full((len(estimate), 3), np.nan)
    reference = reference_of(np.concatenate([position, padding]))
    return np.asarray(jax.jit(align, static_argnums=2)(everything, reference, how))[len(index) :]


def evaluate(track: Track, recording: Recording, alignment: str = "auto") -> Score | None:
    """Errors of a track at the recording's landmarks (or dense truth); None where it has neither."""
    if alignment not in (*ALIGNMENTS, "auto"):
        raise InputError(f"alignment '{alignment}' is unknown{suggest(alignment, (*ALIGNMENTS, 'auto'))}")
    index, position = points_of(recording, track.time, None, track.sensor)
    if len(index) == 0:
        return None
    how = choose_alignment(position) if alignment == "auto" else alignment
    estimate = np.asarray(track.position, float)[index]
    errors = jax.tree.map(float, landmark_errors(estimate, reference_of(position), how))
    flat = np.isfinite(position[:, :2]).all(axis=1)
    known = np.isfinite(position[:, 2])
    distance = track.distance

    def where(there: Any, value: float) -> float | None:
        return float(value) if bool(there) and np.isfinite(value) else None

    height = estimate[known, 2] - position[known, 2]
    if how != "none" and known.any():
        height = height - (height[0] if how == "yaw" else height.mean())
    final = errors.final_2d
    return Score(
        count=len(index),
        alignment=how,
        rms_2d_m=where(flat.any(), errors.rms_2d),
        rms_3d_m=where((flat & known).any(), errors.rms_3d),
        mean_2d_m=where(flat.any(), errors.mean_2d),
        max_2d_m=where(flat.any(), errors.max_2d),
        final_2d_m=where(flat.any(), final),
        percent_of_distance=where(flat.any() and distance > 0, 100 * final / max(distance, 1e-9)),
        armse_m=where(flat.any(), errors.armse),
        rms_height_m=where(known.any(), float(np.sqrt(np.mean(height**2))) if known.any() else 0.0),
        heading_rms_deg=_heading_rms(track, recording),
        warnings=_of_another(track, recording)
        + _alone(int(flat.sum()))
        + _mirrored(estimate[flat], position[flat], errors.rms_2d),
    )


def _alone(count: int) -> tuple[str, ...]:
    """One point is matched with itself by any alignment."""
    return ("a single landmark is matched with itself and tells no error",) if count == 1 else ()


def _mirrored(estimate: np.ndarray, position: np.ndarray, rms: float) -> tuple[str, ...]:
    """A left-handed reference, or a flipped accelerometer, shows as a mirrored path."""
    if len(position) < 4 or not np.isfinite(estimate).all():
        return ()
    flipped = estimate * np.array([1.0, -1.0, 1.0])
    mirrored = float(landmark_errors(flipped, reference_of(position), "yaw_translation").rms_2d)
    extent = float(np.linalg.norm(position[:, :2] - position[:, :2].mean(axis=0), axis=1).max())
    if mirrored < 0.4 * rms and rms > 0.05 * extent:
        return (
            f"the path fits its mirror image better ({mirrored:.2f} m against {rms:.2f} m): the landmarks' "
            "frame is left-handed, or the accelerometer's sign is flipped",
        )
    return ()


def _heading_rms(track: Track, recording: Recording) -> float | None:
    index, position, attitude = attitudes_of(recording, track.time, None, track.sensor)
    if not len(index):
        return None
    found = heading_rms(np.asarray(track.attitude, float)[index], reference_of(position, attitude=attitude))
    return float(found)


def _of_another(track: Track, recording: Recording) -> tuple[str, ...]:
    """What is measured at another place of the body is no truth of this one."""
    marks, truth = recording.landmarks, recording.truth_of(track.sensor)
    source, what = (marks, "landmarks") if marks is not None else (truth, "truth")
    if source is None or source.sensor is None or source.sensor == track.sensor:
        return ()
    return (
        f"the {what} are those of sensor '{source.sensor}', the track is that of '{track.sensor}': how the "
        "two move against each other counts as error",
    )
