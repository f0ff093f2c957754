"""Pokes from a user's own arrays: the paper's experiment in one call, judged by the rules of a recorded session."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from skincal.contacts.answers_of_skin import answers_of
from skincal.contacts.gates import answer_limit, judge
from skincal.contacts.press import FinishedPress, StillMean
from skincal.contacts.tare import Tare
from skincal.contacts.value_order import count_strongest, sum_of_counts
from skincal.model.errors import InputError
from skincal.session.arm_poses import SAME_POSE_COSINE, SAME_POSE_SHIFT_M
from skincal.session.pipeline import Pipeline

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from skincal.contacts.outcome import Outcome
    from skincal.geometry import FloatArray
    from skincal.model.scene import Scene
    from skincal.part.part import Part

POSE_TOLERANCE = 1e-6
"""Largest difference of a rotation's R'R from the identity: single precision passes, a scaled or mirrored matrix does not."""


def pipeline_of_arrays(
    part: Part, wrenches: ArrayLike, responses: ArrayLike, poses: ArrayLike | None, times: ArrayLike | None
) -> Pipeline:
    """Make a session's pipeline, without devices and recording, from arrays; see `skincal.solve`."""
    scene = part.scene
    forces = _array(wrenches, "wrenches", (None, 6), "a row a poke, force in N and moment in N m")
    count = len(forces)
    columns = "a channel" if scene.skin.axes is None else "a value of a skin frame, three a channel,"
    answers = _array(responses, "responses", (count, scene.skin.frame_width), f"a row a poke, a column {columns} of the scene")
    sensors = _sensor_poses(scene, poses, count)
    ends = np.zeros(count) if times is None else _array(times, "times", (count,), "seconds, a number a poke")
    if (lacking := np.flatnonzero(~np.isfinite(forces).all(axis=1))).size:
        raise InputError(f"wrenches: row {lacking[0]} has a value that is no number; leave such pokes out.")
    names = _pose_names(sensors)
    pipeline = Pipeline(scene, (), part.surface, laid=part.laid)
    for row in range(count):
        end_s = float(ends[row])
        still = StillMean(end_s, end_s, end_s, forces[row] * scene.wrench_sign, sensors[row], names[row], 0.0, 0.0)
        pipeline.session.add(_outcome(scene, row + 1, still, answers[row]))
    if scene.skin.axes is not None:
        counts = (count_strongest(scene.skin.axes, each, scene.contacts.response_min) for each in answers)
        pipeline.session.set_value_order(sum_of_counts(counts))
    return pipeline


def _outcome(scene: Scene, number: int, still: StillMean, answers: FloatArray) -> Outcome:
    """Judge one poke from its mean wrench and the change of each value of a skin frame; the tare is zero."""
    limit = answer_limit(scene.contacts, np.zeros(scene.skin.channels))
    candidates = np.arange(scene.skin.channels) if scene.skin.layout is None else scene.skin.layout.channels
    skin = answers_of(scene.skin)
    response, vectors = skin.responses(answers), skin.vectors(answers, None)
    with np.errstate(invalid="ignore"):
        channels = candidates[(response > limit)[candidates]]
    largest = response[candidates]
    best = int(np.nanargmax(largest)) if np.isfinite(largest).any() else -1
    press = FinishedPress(
        number=number,
        start_s=still.start_s,
        end_s=still.end_s,
        period_s=0.0,
        peak=float(np.linalg.norm(still.wrench[:3])),
        saturated=0,
        gap_s=0.0,
        moved=0.0,
        before=Tare(still.time_s, still.start_s, still.end_s, np.zeros(6)),
        still=still,
        channels=channels,
        responses=response[channels],
        vectors=None if vectors is None else vectors[channels],
        largest=float("nan") if len(channels) or best < 0 else float(largest[best]),
        needed=float("nan") if len(channels) or best < 0 else float(limit[candidates[best]]),
    )
    return judge(press, scene, after=None, final=True, ignored=frozenset())


def _sensor_poses(scene: Scene, poses: ArrayLike | None, count: int) -> FloatArray:
    """Return (count, 4, 4) poses of the sensor in the link frame, metres."""
    if poses is None:
        if scene.arm is not None:
            raise InputError(
                f"{scene.path.name}: the arm moves between sensor and {scene.link}; expected poses, (n, 4, 4): the sensor in "
                "the frame of the link at each poke."
            )
        if scene.tool is not None:
            raise InputError(
                f"{scene.path.name}: the sensor sits on the tool, which moves; expected poses, (n, 4, 4): the sensor in the "
                f"frame of {scene.link} at each poke."
            )
        return np.broadcast_to(scene.sensor_pose, (count, 4, 4))
    given = _array(poses, "poses", (count, 4, 4), "the sensor in the frame of the link at each poke, metres")
    turns = given[:, :3, :3]
    off = np.abs(turns.transpose(0, 2, 1) @ turns - np.eye(3)).max(axis=(1, 2), initial=0.0)
    last = np.abs(given[:, 3] - [0.0, 0.0, 0.0, 1.0]).max(axis=1, initial=0.0)
    wrong = (off > POSE_TOLERANCE) | (np.linalg.det(turns) < 0) | (last > 0) | ~np.isfinite(given).all(axis=(1, 2))
    if wrong.any():
        raise InputError(
            f"poses: row {int(wrong.argmax())} is no pose; expected a rotation (determinant 1) and a shift in metres, with the "
            "last row 0 0 0 1."
        )
    return given


def _pose_names(sensors: FloatArray) -> list[str]:
    """Name each pose; nearly equal ones share a name, as those of a streamed arm do."""
    used = np.empty((0, 4, 4))
    names: list[str] = []
    for sensor in sensors:
        # The trace of R'S, for each rotation R that was used.
        cosines = (np.sum(used[:, :3, :3] * sensor[:3, :3], axis=(1, 2)) - 1.0) / 2.0
        shifts = np.linalg.norm(used[:, :3, 3] - sensor[:3, 3], axis=1)
        same = np.flatnonzero((cosines >= SAME_POSE_COSINE) & (shifts <= SAME_POSE_SHIFT_M))
        number = int(same[0]) if len(same) else len(used)
        if number == len(used):
            used = np.concatenate([used, sensor[None]])
        names.append(f"pose {number + 1}")
    return names if len(used) > 1 else [""] * len(names)


def _array(values: ArrayLike, name: str, shape: tuple[int | None, ...], meaning: str) -> FloatArray:
    try:
        found = np.array(values, dtype=float)
    except (TypeError, ValueError):
        raise InputError(f"{name}: is no array of numbers; expected {_words(shape)}, {meaning}.") from None
    if len(found.shape) != len(shape) or any(
        want is not None and have != want for have, want in zip(found.shape, shape, strict=True)
    ):
        raise InputError(f"{name}: has the shape {found.shape}; expected {_words(shape)}, {meaning}.")
    return found


def _words(shape: tuple[int | None, ...]) -> str:
    return f"({', '.join('n' if size is None else str(size) for size in shape)}{',' if len(shape) == 1 else ''})"
