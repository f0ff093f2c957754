"""What pokes at landmarks tell of the rig, and where the taxels lie with and without its correction.

It takes some tenths of a second, so it is worked out beside the session (`review_process.py`), from what has changed since the
last time.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from skincal.contacts.outcome import Contact, Outcome
from skincal.geometry.arrays import FloatArray, IntArray
from skincal.methods import estimate_taxels
from skincal.model.scene import Landmark, Scene
from skincal.modules.pose import ModuleModel
from skincal.rig.correction import RIG, UsedCorrection
from skincal.rig.correction_fit import LandmarkPoke, RigAnswer, RigRequest, correct_rig
from skincal.rig.frame_check import FrameDiagnosis, diagnose
from skincal.session.known_points import landmark_normals, landmark_pokes
from skincal.session.session import Session
from skincal.session.snapshot import Snapshot
from skincal.session.solving import methods_of
from skincal.taxels.result import Method

if TYPE_CHECKING:
    from skincal.surface.mesh import Surface


@dataclass(frozen=True, slots=True, eq=False)
class Review:
    """The answer, as of one moment of a session."""

    generation: int
    """Of what was asked."""
    pokes: tuple[LandmarkPoke, ...]
    """Those at landmarks that count, in the right frame."""
    told: Mapping[int, float]
    """m: of each, by its number, how far its axis passes the landmark as the rig tells."""
    frame: FrameDiagnosis | None
    """What the sensor's frame looks like; None from too few pokes."""
    rig: RigAnswer
    channels: IntArray
    """(n,) of the taxels, ascending."""
    before: Mapping[Method, FloatArray]
    """For each method (n, 3) float, metres, link frame: the taxels as the rig tells, NaN where not known; only while a
    correction of the rig is in use: else the session's estimates are these."""
    after: Mapping[Method, FloatArray]
    """The same under the correction that was found; only where it is worth using and none is in use."""
    used: Mapping[str, UsedCorrection] = field(default_factory=dict[str, UsedCorrection])
    """Corrections that were in use, `Snapshot.corrections` itself: it says nothing of a session that uses others."""


@dataclass(frozen=True, slots=True, eq=False)
class Change:
    """What is new since the last time that was asked."""

    generation: int
    """Counts up."""
    pokes: Mapping[int, Outcome]
    """Pokes that count and are new or others than they were, in the right frame, by their number."""
    gone: tuple[int, ...]
    """Numbers of pokes that count no more."""
    landmarks: tuple[Landmark, ...]
    at_landmarks: Mapping[int, str]
    """Pokes that were at a landmark: number to its name."""
    channels: tuple[int, ...]
    dead: Mapping[int, str]
    corrected: bool
    """A correction of the rig is in use."""


@dataclass(slots=True)
class Asked:
    """What was asked last, on the side that asks."""

    generation: int = 0
    pokes: Mapping[int, Outcome] = field(default_factory=dict[int, Outcome])
    used: Mapping[str, UsedCorrection] = field(default_factory=dict[str, UsedCorrection])
    """Corrections in use."""

    def change(self, session: Session, snapshot: Snapshot) -> Change:
        """Return what is new in a session, of which `snapshot` is the newest."""
        before, now = self.pokes, session.framed()
        self.generation, self.pokes = self.generation + 1, now
        self.used = snapshot.corrections
        return Change(
            generation=self.generation,
            pokes={number: poke for number, poke in now.items() if before.get(number) is not poke},
            gone=tuple(before.keys() - now.keys()),
            landmarks=snapshot.landmarks,
            at_landmarks=snapshot.at_landmarks,
            channels=session.channels,
            dead=snapshot.dead,
            corrected=RIG in snapshot.corrections,
        )


class Reviewer:
    """Follows a session by what changes.

    Parameters
    ----------
    scene, surface : of the session
    """

    def __init__(self, scene: Scene, surface: Surface | None) -> None:
        self._scene, self._surface = scene, surface
        self._methods = methods_of(scene, surface)
        layout = scene.skin.layout
        self._boards = None if layout is None else ModuleModel(layout, scene.skin.anchor, surface)
        self._pokes: dict[int, Outcome] = {}
        self._newest: Change | None = None

    def take(self, change: Change) -> None:
        """Take what is new."""
        for number in change.gone:
            self._pokes.pop(number, None)
        self._pokes.update(change.pokes)
        self._newest = change

    def review(self, between: Callable[[], None]) -> Review:
        """Return what the pokes tell.

        Parameters
        ----------
        between : called every tenth of a second or so; may raise to give up
        """
        newest = self._newest
        if newest is None:
            raise ValueError("nothing was asked yet")
        ordered = [self._pokes[number] for number in sorted(self._pokes)]
        contacts = [one for one in ordered if isinstance(one, Contact)]
        known = {one.name: one for one in newest.landmarks}
        pokes = landmark_pokes(ordered, newest.landmarks, newest.at_landmarks)
        frame = diagnose(pokes, landmark_normals([known[one.name] for one in pokes], self._surface))
        between()
        rig = correct_rig(RigRequest(self._scene, self._surface, contacts, pokes, newest.dead), between)
        between()
        found = None if rig.correction is None or not rig.used else rig.correction
        after = [found.corrected(one) for one in contacts] if found is not None and not newest.corrected else None
        return Review(
            generation=newest.generation,
            pokes=tuple(pokes),
            told={one.poke: one.miss for one in pokes},
            frame=frame,
            rig=rig,
            channels=np.array(newest.channels, dtype=np.int64),
            before=self._places(contacts, newest) if newest.corrected else {},
            after={} if after is None else self._places(after, newest),
        )

    def _places(self, contacts: Sequence[Contact], of: Change) -> dict[Method, FloatArray]:
        """Return for each method (n, 3) where the taxels lie, metres; NaN where not known."""
        noise, unknown = self._scene.noise, np.full(3, np.nan)
        solved = estimate_taxels(contacts, of.channels, self._methods, noise, self._surface, of.dead, model=self._boards)
        return {
            method: np.array([unknown if one.position is None else one.position for one in found.values()]).reshape(-1, 3)
            for method, found in solved.items()
        }
