"""Simulated contacts and landmark pokes without bytes: the mean wrench and responses of accepted pokes.

Gates are not applied. For slides, clocks and losses use `device`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from skincal.contacts.outcome import Contact
from skincal.geometry import FloatArray, IntArray, inverse_pose
from skincal.model.scene import Landmark
from skincal.pokes import LandmarkPokes, Pokes
from skincal.session.landmark_pokes import landmark_normals
from skincal.simulation.operator import Habits, LandmarkHabits, second_touches, unguided_presses
from skincal.simulation.rig_errors import drift_step, slow_mean_sd
from skincal.simulation.simulated_rig import PressedPlaces, Rig, SimulatedArmPose, cone_tilts, push_directions, tangents

POKE_CYCLE_S = 2.5
"""s, one poke and the movement to the next (`Habits`)."""
WRENCH_RATE_HZ = 1000.0
"""Hz, rate of the wrenches in a mean."""
SKIN_FRAME_RATE_HZ = 50.0
"""Hz, rate of the skin frames in a mean."""
TARE_TO_STILL_WINDOW_S = 0.8
"""s, from the middle of a quiet window to the middle of the still one."""
RECIPE_TILT = float(np.radians(28.0))
"""rad, tilt of a printed recipe's pushes from the inward normal: slightly below the friction limit."""
RECIPE_TURN = float(np.radians(120.0))
"""rad, turn of the tilt from round to round of a recipe: three rounds cover all sides."""


def simulate_contacts(
    rig: Rig,
    pokes: PressedPlaces,
    rng: np.random.Generator,
    pose: str | None = None,
    first_poke: int = 1,
    habits: Habits | None = None,
) -> list[Contact]:
    """Simulate the contacts of pokes, in order, without pokes that no taxel answers.

    `habits` has the rate of double touches (`second_touches`), 0 for `None`; it changes no other random number.
    """
    arm_pose = rig.arm_pose(pose)
    (accidents,) = rng.spawn(1)
    doubled, seconds = second_touches(rig, pokes, habits or Habits.careful(), accidents)
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
    starts = first_poke * POKE_CYCLE_S + POKE_CYCLE_S * np.arange(len(pokes))
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
    """Return unguided presses: `per_taxel` rounds over the taxels, each in a new random order."""
    targets = np.concatenate([rng.permutation(rig.channels) for _ in range(per_taxel)])
    return unguided_presses(rig, targets, habits or Habits.careful(), rng)


def _answers(rig: Rig, pokes: PressedPlaces, rng: np.random.Generator) -> list[tuple[IntArray, FloatArray]]:
    """Return for each poke the rows of nearby taxels and their responses with noise."""
    rows, answers = rig.answers(pokes, pokes.forces)
    settings = rig.scene.contacts
    frames = settings.still_s * SKIN_FRAME_RATE_HZ, settings.quiet_s * SKIN_FRAME_RATE_HZ
    sd = rig.errors.skin_noise * rig.counts * np.sqrt(1 / frames[0] + 1 / frames[1])
    answers = answers + sd * rng.standard_normal(answers.shape)
    return [(rows[i], answers[i]) for i in range(len(rows))]


def _both(rig: Rig, first: tuple[IntArray, FloatArray], other: tuple[IntArray, FloatArray]) -> tuple[IntArray, FloatArray]:
    """Add the responses to two touches."""
    answers = np.zeros(len(rig.channels))
    answers[first[0]] += first[1]
    answers[other[0]] += other[1]
    rows = np.union1d(first[0], other[0])
    return rows, answers[rows]


def _mean_wrenches(rig: Rig, pokes: PressedPlaces, arm_pose: SimulatedArmPose, rng: np.random.Generator) -> FloatArray:
    """Return the wrench readings (n, 6) without noise."""
    e1, e2 = tangents(pokes.normals)
    beside = rig.errors.scatter * rng.standard_normal((len(pokes), 2))
    points = pokes.points + beside[:, :1] * e1 + beside[:, 1:] * e2
    return rig.read_wrenches(rig.true_wrenches(points, pokes.forces[:, None] * pokes.directions, arm_pose))


def _window_noise(rig: Rig, count: int, seconds: float, rng: np.random.Generator) -> FloatArray:
    """Draw the noise (n, 6) of the mean over a window of `seconds`."""
    errors = rig.errors
    white = np.repeat([errors.force_noise, errors.moment_noise], 3) / np.sqrt(seconds * WRENCH_RATE_HZ)
    return np.hypot(white, slow_mean_sd(errors, seconds)) * rng.standard_normal((count, 6))


def _tared_noise(rig: Rig, count: int, rng: np.random.Generator) -> tuple[FloatArray, FloatArray]:
    """Draw the noise and drift (n, 6) after taring around every poke, and the differences of the tares (n,), N."""
    settings = rig.scene.contacts
    still = _window_noise(rig, count, settings.still_s, rng)
    # Drift relative to the press; the tares before and after have independent random walks.
    walk = drift_step(rig.errors) * np.sqrt(TARE_TO_STILL_WINDOW_S)
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
) -> LandmarkPokes:
    """Simulate `per_pose` pokes at the landmarks in turn in each arm pose of the rig.

    `beside` (n,), metres, is an additional offset of each poke from its landmark; `None`: 0.
    """
    every: list[LandmarkPokes] = []
    for pose, first in zip(rig.arm_poses, range(0, len(rig.arm_poses) * per_pose, per_pose), strict=True):
        wanted = [landmarks[(first + i) % len(landmarks)] for i in range(per_pose)]
        off = np.zeros(per_pose) if beside is None else beside[first : first + per_pose]
        presses = _aimed(rig, wanted, off, rng)
        arm_pose = rig.arm_pose(pose)
        wrenches = _mean_wrenches(rig, presses, arm_pose, rng) + _tared_noise(rig, per_pose, rng)[0]
        pokes = Pokes(
            number=first_poke + np.arange(first, first + per_pose),
            force=wrenches[:, :3],
            moment=wrenches[:, 3:],
            link_from_sensor=np.tile(arm_pose.reported, (per_pose, 1, 1)),
            pose=np.full(per_pose, arm_pose.name),
        )
        every.append(LandmarkPokes.at(pokes, [mark.name for mark in wanted], [mark.place for mark in wanted]))
    return LandmarkPokes.concatenate(every)


def _aimed(rig: Rig, wanted: list[Landmark], off: FloatArray, rng: np.random.Generator) -> PressedPlaces:
    """Return a press at each landmark with the aim error and the offsets `off` (n,), metres."""
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


@dataclass(frozen=True, slots=True, eq=False)
class TipTracker:
    """A robot or a tracker that reports the position of the tip in a fixed frame."""

    fixed_from_sensor: FloatArray
    """(4, 4) float, metres: the sensor in the fixed frame."""
    sd: float
    """m, noise of each coordinate."""

    def add_tips(
        self,
        contacts: Sequence[Contact],
        pokes: PressedPlaces,
        arm_pose: SimulatedArmPose,
        rng: np.random.Generator,
        first_poke: int = 1,
    ) -> list[Contact]:
        """Return contacts of `simulate_contacts` with the position of the tip."""
        fixed_from_link = self.fixed_from_sensor @ inverse_pose(arm_pose.true)
        rows = [contact.poke - first_poke for contact in contacts]
        tips = pokes.points[rows] @ fixed_from_link[:3, :3].T + fixed_from_link[:3, 3]
        tips = tips + self.sd * rng.standard_normal(tips.shape)
        return [replace(contact, tip=tip) for contact, tip in zip(contacts, tips, strict=True)]
