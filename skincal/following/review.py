"""Review of a session's landmark pokes: the sensor's frame, the rig's correction, and the taxels with and without it.

A review follows from a frozen request alone and takes some tenths of a second, so the window has another process do it.
"""

from __future__ import annotations

import pickle
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np

from skincal.contacts.outcome import Contact
from skincal.contacts.skin_pokes import SkinPokes
from skincal.geometry import FloatArray, IntArray
from skincal.methods import estimate_taxels
from skincal.model.errors import InputError
from skincal.model.scene import KnownDistance, Landmark, SkinSpec
from skincal.model.wrench_frames import frame_in_question
from skincal.modules.pose import ModuleModel
from skincal.pokes import LandmarkPokes
from skincal.rig.correction import RIG, UsedCorrection
from skincal.rig.correction_fit import RigAnswer, RigRequest, correct_rig
from skincal.rig.frame_check import FrameDiagnosis, check_frame
from skincal.rig.scene_mistakes import Mistake, MistakeKind
from skincal.session.landmark_pokes import landmark_normals
from skincal.session.session import Session
from skincal.session.solving import methods_of
from skincal.taxels.result import Method

if TYPE_CHECKING:
    from skincal.mesh.surface import Surface

FINISH_REVIEW_IF_RUNNING_FOR_S = 5.0
"""s. A review that has taken this long is finished, although a newer one waits. Else no review of a large part would end."""
PART_MOTION_PREFERRED_WITHIN = 0.7
"""Share of the miss with another pose of the part. A correction of the sensor that leaves more is not better: the part's pose
is typed, and the sensor's is known from its mount."""


@dataclass(frozen=True, slots=True, eq=False)
class Review:
    """Findings of one review of the sensor and the arm by landmark pokes."""

    pokes: LandmarkPokes
    """Landmark pokes that count, after the frame's correction."""
    reported: Mapping[int, float]
    """m: by poke, the distance between its axis and its landmark, without a correction of the rig."""
    frame: FrameDiagnosis | None
    """`None` with too few pokes."""
    rig: RigAnswer
    channels: IntArray
    """(n,) of the taxels, ascending."""
    before: Mapping[Method, FloatArray]
    """By method (n, 3) float, metres, link frame: taxels without the rig's correction, NaN if unknown.

    Empty while no correction of the rig is in use: then the session's estimates are these."""
    after: Mapping[Method, FloatArray]
    """The same with the correction that was found. Empty if it is not worth using or one is in use."""
    used: Mapping[str, UsedCorrection] = field(default_factory=dict[str, UsedCorrection])
    """Corrections in use at the request, `Decisions.corrections` itself. It is void for a session that uses others."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class ReviewRequest(RigRequest):
    """Input of a review of the rig: of its correction, of the frame's check, and of the taxels under both."""

    known_landmarks: tuple[Landmark, ...]
    channels: tuple[int, ...]
    used: Mapping[str, UsedCorrection]
    frame_in_question: str = ""
    """Frame of the wrench's messages that may explain a wrong sensor frame; empty for none."""
    mesh_sha256: str | None = None
    """Of the part's mesh; `None` without one."""

    @staticmethod
    def from_session(session: Session) -> ReviewRequest:
        """Make a request with the session's present state."""
        of, decisions = session.rig_request(), session.decisions
        return ReviewRequest(
            scene=of.scene,
            surface=of.surface,
            contacts=of.contacts,
            landmarks=of.landmarks,
            dead=of.dead,
            known_landmarks=decisions.landmarks,
            channels=session.channels,
            used=decisions.corrections,
            frame_in_question=frame_in_question(session.wrench_frames),
            mesh_sha256=None if of.surface is None else of.surface.sha256,
        )

    def packed(self) -> ReviewRequest:
        """Make the request ready for another process: contacts as arrays, and no mesh, since reading it there is quicker."""
        return replace(self, contacts=SkinPokes.collect(self.contacts), surface=None)

    def load_part(self) -> tuple[Surface | None, ModuleModel | None]:
        """Load mesh and modules; `InputError` if the mesh is gone or has changed."""
        of = self.scene
        return _load_part(pickle.dumps((self.mesh_sha256, of.surface, of.skin, of.distances)))


def diagnose_rig(request: ReviewRequest, between: Callable[[], None] = lambda: None) -> tuple[FrameDiagnosis | None, RigAnswer]:
    """Check the sensor's frame (`None` with too few pokes) and fit the rig's correction.

    `between` is called every tenth of a second or so, and may raise to give up.
    """
    pokes, known = request.landmarks, {landmark.name: landmark for landmark in request.known_landmarks}
    frame = check_frame(pokes, landmark_normals([known[name] for name in pokes.name.tolist()], request.surface))
    if frame is not None:
        frame = replace(frame, wrench_frame=request.frame_in_question)
    between()
    rig = correct_rig(request, between)
    return (frame, rig) if request.scene.tool is None or frame is None else _with_part_motion(frame, rig, pokes)


def _with_part_motion(frame: FrameDiagnosis, rig: RigAnswer, pokes: LandmarkPokes) -> tuple[FrameDiagnosis, RigAnswer]:
    """Name a wrong pose of the part, and offer no correction of the sensor then, unless that explains the pokes better."""
    from skincal.rig.tool_mistakes import find_part_motion

    found = find_part_motion(pokes)
    others = [rig.after] if rig.used else []
    others += [frame.corrected_miss] if frame.explained and not frame.right else []
    if found is None or min(others, default=np.inf) < PART_MOTION_PREFERRED_WITHIN * found.miss:
        return frame, rig
    mistake = Mistake(MistakeKind.TOOL_PART, motion=found.motion, shift=found.motion[:3, 3])
    # Not explained by the sensor's frame: nothing is offered.
    named = replace(frame, right=False, sure=True, explained=False, corrected_miss=found.miss, mistake=mistake)
    return named, replace(rig, used=False)


def review_rig(request: ReviewRequest, between: Callable[[], None] = lambda: None, model: ModuleModel | None = None) -> Review:
    """Review a session.

    Parameters
    ----------
    between : as for `diagnose_rig`
    model : of the scene's modules; made if it is missing
    """
    pokes = request.landmarks
    frame, rig = diagnose_rig(request, between)
    between()
    found, is_corrected = rig.usable, RIG in request.used
    after = [found.corrected(contact) for contact in request.contacts] if found is not None and not is_corrected else None
    if model is None and (is_corrected or after is not None):
        model = _model_of(request.scene.skin, request.scene.distances, request.surface)
    return Review(
        pokes=pokes,
        reported=dict(zip(pokes.number.tolist(), pokes.landmark_miss.tolist(), strict=True)),
        frame=frame,
        rig=rig,
        channels=np.array(request.channels, dtype=np.int64),
        before=_places(request, request.contacts, model) if is_corrected else {},
        after={} if after is None else _places(request, after, model),
        used=request.used,
    )


def _model_of(skin: SkinSpec, distances: Sequence[KnownDistance], surface: Surface | None) -> ModuleModel | None:
    return None if skin.layout is None else ModuleModel(skin.layout, skin.anchor, surface, distances)


def _places(request: ReviewRequest, contacts: Sequence[Contact], model: ModuleModel | None) -> dict[Method, FloatArray]:
    scene, surface, unknown = request.scene, request.surface, np.full(3, np.nan)
    methods = methods_of(scene, surface)
    solved = estimate_taxels(contacts, request.channels, methods, scene.noise, surface, request.dead, model=model)
    return {
        method: np.array([unknown if e.position is None else e.position for e in found.values()]).reshape(-1, 3)
        for method, found in solved.items()
    }


@lru_cache(maxsize=1)
def _load_part(pickled: bytes) -> tuple[Surface | None, ModuleModel | None]:
    """Load mesh and modules of a part, once for all its reviews. Pickled: the mesh's SHA-256, its file, skin, distances."""
    from skincal.mesh.load import load_surface

    mesh_sha256, file, skin, distances = pickle.loads(pickled)
    surface = None
    if file is not None:
        surface, _ = load_surface(file)
        if surface.sha256 != mesh_sha256:
            raise InputError(f"{file.path}: the mesh changed since the session was opened; open it again.")
    return surface, _model_of(skin, distances, surface)


class _GivenUpError(Exception):
    """A newer request waits."""


def review_packed(request: ReviewRequest, is_wanted: Callable[[], bool]) -> Review | None:
    """Do the review of a packed request of another process; `None` if a newer request stopped it.

    Parameters
    ----------
    is_wanted : says whether it is the newest request; work on another is given up, unless it has taken long

    Raises
    ------
    InputError
        The mesh is gone or has changed.
    """
    begun = time.monotonic()

    def between() -> None:
        if not is_wanted() and time.monotonic() - begun < FINISH_REVIEW_IF_RUNNING_FOR_S:
            raise _GivenUpError

    try:
        between()
        surface, model = request.load_part()
        return review_rig(replace(request, contacts=list(request.contacts), surface=surface), between, model)
    except _GivenUpError:
        return None
