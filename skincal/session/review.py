"""What pokes at landmarks say of the rig, and where the taxels lie with and without its correction.

It takes some tenths of a second, so it is worked out in another process (`review_change`), from what has changed since the last
time.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from enum import Enum
from typing import TYPE_CHECKING

import numpy as np

from skincal.contacts.outcome import Contact, Outcome
from skincal.geometry import FloatArray, IntArray
from skincal.methods import estimate_taxels
from skincal.model.errors import InputError
from skincal.model.scene import Landmark, Scene
from skincal.modules.pose import ModuleModel
from skincal.rig.correction import RIG, UsedCorrection
from skincal.rig.correction_fit import LandmarkPoke, RigAnswer, RigRequest, correct_rig
from skincal.rig.frame_check import FrameDiagnosis, diagnose
from skincal.session.landmark_pokes import landmark_normals, landmark_pokes
from skincal.session.part import load_scene_surface
from skincal.session.session import Session
from skincal.session.snapshot import Snapshot
from skincal.session.solving import methods_of
from skincal.taxels.result import Method

if TYPE_CHECKING:
    from skincal.mesh.surface import Surface

PATIENCE_S = 5.0
"""s. Work on an older change goes on after that: on a large part each poke would else end the work on the one before."""


@dataclass(frozen=True, slots=True, eq=False)
class Review:
    """The answer, as of one moment of a session."""

    generation: int
    """Of what was asked."""
    pokes: tuple[LandmarkPoke, ...]
    """Those at landmarks that count, in the right frame."""
    reported: Mapping[int, float]
    """m: of each, by its number, how far its axis passes the landmark as the rig reports it."""
    frame: FrameDiagnosis | None
    """What the sensor's frame looks like; None from too few pokes."""
    rig: RigAnswer
    channels: IntArray
    """(n,) of the taxels, ascending."""
    before: Mapping[Method, FloatArray]
    """For each method (n, 3) float, metres, link frame: the taxels as the rig reports, NaN where not known; only while a
    correction of the rig is in use: else the session's estimates are these."""
    after: Mapping[Method, FloatArray]
    """The same under the correction that was found; only where it is worth using and none is in use."""
    used: Mapping[str, UsedCorrection] = field(default_factory=dict[str, UsedCorrection])
    """Corrections that were in use, `Decisions.corrections` itself: it says nothing of a session that uses others."""


@dataclass(frozen=True, slots=True, eq=False)
class Change:
    """What is new since the last time that was asked."""

    generation: int
    """Counts up."""
    since: int
    """Generation of the change before; 0 where this one holds everything."""
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
    known: int = 0
    """Generation that the other side knows; 0 where it knows nothing."""
    pokes: Mapping[int, Outcome] = field(default_factory=dict[int, Outcome])
    used: Mapping[str, UsedCorrection] = field(default_factory=dict[str, UsedCorrection])
    """Corrections in use."""

    def change(self, session: Session, snapshot: Snapshot) -> Change:
        """Return what is new in a session, of which `snapshot` is the newest."""
        counting = [record.outcome.poke for record in snapshot.pokes if not record.excluded]
        before, since = self.pokes, self.known
        now = {outcome.poke: outcome for outcome in session.frame_corrected(counting)}
        self.generation = self.known = self.generation + 1
        self.pokes, self.used = now, snapshot.decisions.corrections
        return Change(
            generation=self.generation,
            since=since,
            # By identity: `Session.frame_corrected` returns the same object for what did not change.
            pokes={number: poke for number, poke in now.items() if before.get(number) is not poke},
            gone=tuple(before.keys() - now.keys()),
            landmarks=snapshot.decisions.landmarks,
            at_landmarks=snapshot.at_landmarks,
            channels=session.channels,
            dead=snapshot.dead,
            corrected=RIG in snapshot.decisions.corrections,
        )

    def forget(self) -> None:
        """Let the next change hold everything."""
        self.known, self.pokes = 0, {}


class Reviewer:
    """Follows a session by what changes."""

    def __init__(self, scene: Scene, surface: Surface | None) -> None:
        self._scene, self._surface = scene, surface
        self._methods = methods_of(scene, surface)
        layout = scene.skin.layout
        self._module_model = None if layout is None else ModuleModel(layout, scene.skin.anchor, surface, scene.distances)
        self._pokes: dict[int, Outcome] = {}
        self._newest: Change | None = None

    @property
    def generation(self) -> int:
        """Of the newest change; 0 before the first."""
        return 0 if self._newest is None else self._newest.generation

    def take(self, change: Change) -> None:
        """Take what is new."""
        for number in change.gone:
            self._pokes.pop(number, None)
        self._pokes.update(change.pokes)
        self._newest = change

    def review(self, between: Callable[[], None]) -> Review:
        """Return what the pokes say; `between` is called every tenth of a second or so, and may raise to give up."""
        newest = self._newest
        if newest is None:
            raise ValueError("nothing was asked yet")
        ordered = [self._pokes[number] for number in sorted(self._pokes)]
        contacts = [outcome for outcome in ordered if isinstance(outcome, Contact)]
        known = {landmark.name: landmark for landmark in newest.landmarks}
        pokes = landmark_pokes(ordered, newest.landmarks, newest.at_landmarks)
        frame = diagnose(pokes, landmark_normals([known[poke.name] for poke in pokes], self._surface))
        between()
        rig = correct_rig(RigRequest(self._scene, self._surface, contacts, pokes, newest.dead), between)
        between()
        found = None if rig.correction is None or not rig.used else rig.correction
        after = [found.corrected(contact) for contact in contacts] if found is not None and not newest.corrected else None
        return Review(
            generation=newest.generation,
            pokes=tuple(pokes),
            reported={poke.poke: poke.miss for poke in pokes},
            frame=frame,
            rig=rig,
            channels=np.array(newest.channels, dtype=np.int64),
            before=self._places(contacts, newest) if newest.corrected else {},
            after={} if after is None else self._places(after, newest),
        )

    def _places(self, contacts: Sequence[Contact], of: Change) -> dict[Method, FloatArray]:
        """Return for each method (n, 3) where the taxels lie, metres; NaN where not known."""
        noise, unknown = self._scene.noise, np.full(3, np.nan)
        solved = estimate_taxels(contacts, of.channels, self._methods, noise, self._surface, of.dead, model=self._module_model)
        return {
            method: np.array([unknown if e.position is None else e.position for e in found.values()]).reshape(-1, 3)
            for method, found in solved.items()
        }


@dataclass(frozen=True, slots=True, eq=False)
class ReviewedPart:
    """What a session is of; the mesh is read again, which is quicker than to send it."""

    scene: Scene
    mesh_sha256: str | None

    def load_surface(self) -> Surface | None:
        """Load the mesh; InputError where it is gone, or another than the session's."""
        surface, _ = load_scene_surface(self.scene)
        if surface is not None and self.scene.surface is not None and surface.sha256 != self.mesh_sha256:
            raise InputError(f"{self.scene.surface.path}: the mesh changed since the session was opened; open it again.")
        return surface


class Unreviewed(Enum):
    """Why there is no review."""

    GIVEN_UP = "a newer change waits"
    UNKNOWN = "what came before this change is not known here"


class _GivenUpError(Exception):
    """A newer change waits."""


_reviewers: dict[str, Reviewer] = {}
"""The newest session of this process."""


def review_change(session: str, part: ReviewedPart | None, change: Change, wanted: Callable[[], bool]) -> Review | Unreviewed:
    """Take a change of a session and review it; what came before is kept in this process.

    Parameters
    ----------
    session : a name of it, unlike any other's
    part : where the change holds everything, else None; `InputError` as for its `load_surface`
    wanted : returns whether this change is the newest; the work on another is given up, unless it has taken long
    """
    if part is not None:
        _reviewers.clear()
        _reviewers[session] = Reviewer(part.scene, part.load_surface())
    reviewer = _reviewers.get(session)
    if reviewer is None or reviewer.generation != change.since:
        return Unreviewed.UNKNOWN
    reviewer.take(change)
    begun = time.monotonic()

    def between() -> None:
        if not wanted() and time.monotonic() - begun < PATIENCE_S:
            raise _GivenUpError

    try:
        between()
        return reviewer.review(between)
    except _GivenUpError:
        return Unreviewed.GIVEN_UP
