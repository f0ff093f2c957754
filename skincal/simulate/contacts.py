"""Pokes straight to contacts and landmark pokes, without bytes: what an accepted poke's mean wrench and answers would be.

Gates are not run: unless the operator has the habit of touching a second place too, every poke here is one still touch of
one place, so none would be rejected but for too little force or too many taxels. For slides, clocks and losses use `device`.
"""

from __future__ import annotations

import numpy as np

from skincal.contacts.outcome import Contact
from skincal.geometry import FloatArray, IntArray
from skincal.model.scene import Landmark
from skincal.rig.correction_fit import LandmarkPoke
from skincal.session.landmark_pokes import landmark_normals
from skincal.simulate.operator import Habits, LandmarkHabits, touches_beside, unguided_presses
from skincal.simulate.rig_errors import drift_step, slow_mean_sd
from skincal.simulate.simulated_rig import PressedPlaces, Rig, SimulatedArmPose, cone_tilts, push_directions, tangents

CYCLE_S = 2.5
"""s, one poke and the way to the next (`Habits`)."""
WRENCH_HZ = 1000.0
"""Hz, readings that enter a mean."""
SKIN_HZ = 50.0
"""Hz, frames that enter a mean."""
TARE_TO_STILL_S = 0.8
"""s, from the middle of a quiet window to the middle of the still one."""
RECIPE_TILT = float(np.radians(28.0))
"""rad. A push of a recipe leans this far from the inward normal: a little less than friction holds."""
RECIPE_TURN = float(np.radians(120.0))
"""rad from each round of a recipe to the next: after three the lean has been to all sides."""


def simulate_contacts(
    rig: Rig,
    pokes: PressedPlaces,
    rng: np.random.Generator,
    pose: str | None = None,
    first_poke: int = 1,
    habits: Habits | None = None,
) -> list[Contact]:
    """Return the contacts that pokes end as, in their order; those that no taxel answers are left out.

    Habits say how often a second place is touched too (`touches_beside`), never for None. All else is drawn as without, so
    that two sessions differ in these pokes alone.
    """
    arm_pose = rig.arm_pose(pose)
    # A spawned generator leaves what `rng` draws as it is.
    (accidents,) = rng.spawn(1)
    doubled, seconds = touches_beside(rig, pokes, habits or Habits.careful(), accidents)
    wrenches = _mean_wrenches(rig, pokes, arm_pose, rng)
    noise, change = _tared_noise(rig, len(pokes), rng)
    wrenches = wrenches + noise
    wrenches[doubled] += _mean_wrenches(rig, seconds, arm_pose, accidents)
    answers = _answers(rig, pokes, rng)
    rows, more = rig.answers(seconds, seconds.forces)
    touched: list[int] = doubled.tolist()
    for second, i in enumerate(touched):
        answers[i] = _both(rig, answers[i], (rows[second], more[second]))
    settings = rig.scene.contacts
    starts = first_poke * CYCLE_S + CYCLE_S * np.arange(len(pokes))
    contacts: list[Contact] = []
    for i, (rows, responses) in enumerate(answers):
        answering = responses > settings.response_min
        if not answering.any():
            continue
        order = np.argsort(rig.channels[rows[answering]])
        contacts.append(
            Contact(
                poke=first_poke + i,
                start_s=float(starts[i]),
                end_s=float(starts[i] + settings.still_s),
                force=wrenches[i, :3],
                moment=wrenches[i, 3:],
                channels=rig.channels[rows[answering]][order],
                responses=responses[answering][order],
                link_from_sensor=arm_pose.reported,
                pose=arm_pose.name,
                tare_change=float(change[i]),
                final=True,
            )
        )
    return contacts


def unguided(rig: Rig, per_taxel: int, rng: np.random.Generator, habits: Habits | None = None) -> PressedPlaces:
    """Return unguided pokes, `per_taxel` at each taxel, each round in a new random order."""
    targets = np.concatenate([rng.permutation(rig.channels) for _ in range(per_taxel)])
    return unguided_presses(rig, targets, habits or Habits.careful(), rng)


def _answers(rig: Rig, pokes: PressedPlaces, rng: np.random.Generator) -> list[tuple[IntArray, FloatArray]]:
    """Return for each poke some taxels, rows of the rig's, and their answers with noise."""
    rows, answers = rig.answers(pokes, pokes.forces)
    settings = rig.scene.contacts
    frames = settings.still_s * SKIN_HZ, settings.quiet_s * SKIN_HZ
    sd = rig.errors.skin_noise * rig.counts * np.sqrt(1 / frames[0] + 1 / frames[1])
    answers = answers + sd * rng.standard_normal(answers.shape)
    return [(rows[i], answers[i]) for i in range(len(rows))]


def _both(rig: Rig, first: tuple[IntArray, FloatArray], other: tuple[IntArray, FloatArray]) -> tuple[IntArray, FloatArray]:
    """Return the answers to two touches at once."""
    answers = np.zeros(len(rig.channels))
    answers[first[0]] += first[1]
    answers[other[0]] += other[1]
    rows = np.union1d(first[0], other[0])
    return rows, answers[rows]


def _mean_wrenches(rig: Rig, pokes: PressedPlaces, arm_pose: SimulatedArmPose, rng: np.random.Generator) -> FloatArray:
    """Return (n, 6) what the sensor makes of the forces, before noise."""
    e1, e2 = tangents(pokes.normals)
    beside = rig.errors.scatter * rng.standard_normal((len(pokes), 2))
    points = pokes.points + beside[:, :1] * e1 + beside[:, 1:] * e2
    return rig.read_wrenches(rig.true_wrenches(points, pokes.forces[:, None] * pokes.directions, arm_pose))


def _window_noise(rig: Rig, count: int, seconds: float, rng: np.random.Generator) -> FloatArray:
    """Return (n, 6) noise of the mean over a window."""
    errors = rig.errors
    white = np.repeat([errors.force_noise, errors.moment_noise], 3) / np.sqrt(seconds * WRENCH_HZ)
    return np.hypot(white, slow_mean_sd(errors, seconds)) * rng.standard_normal((count, 6))


def _tared_noise(rig: Rig, count: int, rng: np.random.Generator) -> tuple[FloatArray, FloatArray]:
    """Return (n, 6) noise and drift that a tare around every poke leaves, and (n,) by how many newtons the tares differ."""
    settings = rig.scene.contacts
    still = _window_noise(rig, count, settings.still_s, rng)
    # Drift is counted from the press: the tares before and after it are off by a walk of their own each.
    walk = drift_step(rig.errors) * np.sqrt(TARE_TO_STILL_S)
    before = _window_noise(rig, count, settings.quiet_s, rng) - walk * rng.standard_normal((count, 6))
    after = _window_noise(rig, count, settings.quiet_s, rng) + walk * rng.standard_normal((count, 6))
    return still - (before + after) / 2, np.linalg.norm((after - before)[:, :3], axis=1)


def poke_landmarks(
    rig: Rig,
    landmarks: tuple[Landmark, ...],
    per_pose: int,
    rng: np.random.Generator,
    first_poke: int = 1,
    beside: FloatArray | None = None,
) -> list[LandmarkPoke]:
    """Return pokes at the landmarks in turn, so many in each arm pose of the rig.

    `beside` (n,), metres, is how far each poke lies off its landmark by mistake; none for None.
    """
    found: list[LandmarkPoke] = []
    for pose in rig.arm_poses:
        wanted = [landmarks[(len(found) + i) % len(landmarks)] for i in range(per_pose)]
        number = first_poke + len(found)
        off = np.zeros(per_pose) if beside is None else beside[len(found) : len(found) + per_pose]
        pokes = _aimed(rig, wanted, off, rng)
        arm_pose = rig.arm_pose(pose)
        wrenches = _mean_wrenches(rig, pokes, arm_pose, rng) + _tared_noise(rig, per_pose, rng)[0]
        found += [
            LandmarkPoke(number + i, landmark.name, landmark.place, wrench[:3], wrench[3:], arm_pose.reported, arm_pose.name)
            for i, (landmark, wrench) in enumerate(zip(wanted, wrenches, strict=True))
        ]
    return found


def _aimed(rig: Rig, wanted: list[Landmark], off: FloatArray, rng: np.random.Generator) -> PressedPlaces:
    """Return one poke at each of `wanted`, `off` metres (n,) beside it and by the hand's aim."""
    habits, count = LandmarkHabits(), len(wanted)
    places = np.array([landmark.place for landmark in wanted])
    up = np.array([0.0, 0.0, 1.0])
    normals = np.array([up if normal is None else normal for normal in landmark_normals(wanted, rig.surface)])
    e1, e2 = tangents(normals)
    beside = habits.aim * rng.standard_normal((count, 2)) + np.column_stack([off, np.zeros(count)])
    tilts, azimuths = cone_tilts(count, habits.cone, rng), rng.uniform(-np.pi, np.pi, count)
    return PressedPlaces(
        np.full(count, -1, dtype=np.int64), places + beside[:, :1] * e1 + beside[:, 1:] * e2, normals,
        push_directions(normals, tilts, azimuths), rng.uniform(*habits.force, count), np.zeros(count),
    )  # fmt: skip
