"""Review of a session's landmark pokes: the sensor's frame, the rig's correction, and the taxels with and without it.

A review follows from a frozen request alone and takes some tenths of a second, so the window has another process do it.
"""

from __future__ import annotations

import pickle
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np

from skincal.contacts.outcome import Contact
from skincal.geometry import FloatArray, IntArray
from skincal.methods import estimate_taxels
from skincal.model.errors import InputError
from skincal.model.scene import Landmark, Scene
from skincal.model.wrench_frames import frame_in_question
from skincal.modules.pose import ModuleModel
from skincal.part.part import load_scene_surface
from skincal.pokes import LandmarkPokes
from skincal.rig.correction import RIG, UsedCorrection
from skincal.rig.correction_fit import RigAnswer, RigRequest, correct_rig
from skincal.rig.frame_check import FrameDiagnosis, diagnose
from skincal.session.landmark_pokes import landmark_normals
from skincal.session.session import Session
from skincal.session.solving import methods_of
from skincal.taxels.result import Method

if TYPE_CHECKING:
    from skincal.mesh.surface import Surface

FINISH_REVIEW_IF_RUNNING_FOR_S = 5.0
"""s. A review that has taken this long is finished, although a newer one waits. Else no review of a large part would end."""


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


@dataclass(frozen=True, slots=True, eq=False)
class ReviewRequest:
    """Input of a review of the rig."""

    rig: RigRequest
    landmarks: tuple[Landmark, ...]
    channels: tuple[int, ...]
    used: Mapping[str, UsedCorrection]
    frame_in_question: str = ""
    """Frame of the wrench's messages that may explain a wrong sensor frame; empty for none."""

    @staticmethod
    def from_session(session: Session) -> ReviewRequest:
        """Make a request with the session's present state."""
        decisions = session.decisions
        asked = session.rig_request(), decisions.landmarks, session.channels, decisions.corrections
        return ReviewRequest(*asked, frame_in_question(session.wrench_frames))


def diagnose_rig(request: ReviewRequest, between: Callable[[], None] = lambda: None) -> tuple[FrameDiagnosis | None, RigAnswer]:
    """Check the sensor's frame (`None` with too few pokes) and fit the rig's correction.

    `between` is called every tenth of a second or so, and may raise to give up.
    """
    pokes, known = request.rig.landmarks, {landmark.name: landmark for landmark in request.landmarks}
    frame = diagnose(pokes, landmark_normals([known[name] for name in pokes.name.tolist()], request.rig.surface))
    if frame is not None:
        frame = replace(frame, wrench_frame=request.frame_in_question)
    between()
    return frame, correct_rig(request.rig, between)


def review_rig(request: ReviewRequest, between: Callable[[], None] = lambda: None, model: ModuleModel | None = None) -> Review:
    """Review a session.

    Parameters
    ----------
    between : as for `diagnose_rig`
    model : of the scene's modules; made if it is missing
    """
    of = request.rig
    frame, rig = diagnose_rig(request, between)
    between()
    found, is_corrected = rig.correction if rig.used else None, RIG in request.used
    after = [found.corrected(contact) for contact in of.contacts] if found is not None and not is_corrected else None
    if model is None and (is_corrected or after is not None):
        model = _model_of(of.scene, of.surface)
    return Review(
        pokes=of.landmarks,
        reported=dict(zip(of.landmarks.number.tolist(), of.landmarks.landmark_miss.tolist(), strict=True)),
        frame=frame,
        rig=rig,
        channels=np.array(request.channels, dtype=np.int64),
        before=_places(request, of.contacts, model) if is_corrected else {},
        after={} if after is None else _places(request, after, model),
        used=request.used,
    )


def _model_of(scene: Scene, surface: Surface | None) -> ModuleModel | None:
    layout = scene.skin.layout
    return None if layout is None else ModuleModel(layout, scene.skin.anchor, surface, scene.distances)


def _places(request: ReviewRequest, contacts: Sequence[Contact], model: ModuleModel | None) -> dict[Method, FloatArray]:
    scene, surface, unknown = request.rig.scene, request.rig.surface, np.full(3, np.nan)
    methods = methods_of(scene, surface)
    solved = estimate_taxels(contacts, request.channels, methods, scene.noise, surface, request.rig.dead, model=model)
    return {
        method: np.array([unknown if e.position is None else e.position for e in found.values()]).reshape(-1, 3)
        for method, found in solved.items()
    }


@dataclass(frozen=True, slots=True, eq=False)
class SentReview:
    """A request on its way to another process. Arrays: ten thousand pickled contacts would hold Python's lock for 0.3 s.

    The mesh is not sent, since reading it there is quicker.
    """

    request: ReviewRequest
    """Without contacts and mesh."""
    mesh_sha256: str | None
    values: FloatArray
    """(n, 27) float, SI, of the contacts: poke, how many channels, start, end, force, moment, pose row by row, tare change."""
    answers: FloatArray
    """(2, m) float: channels and responses of all contacts."""
    poses: tuple[str, ...]

    @staticmethod
    def pack(request: ReviewRequest) -> SentReview:
        """Pack a request."""
        contacts, surface = request.rig.contacts, request.rig.surface
        values = [
            [c.poke, len(c.channels), c.start_s, c.end_s, *c.force, *c.moment, *c.link_from_sensor.ravel(), c.tare_change]
            for c in contacts
        ]
        answers = [np.array([c.channels, c.responses], dtype=np.float64) for c in contacts]
        return SentReview(
            replace(request, rig=replace(request.rig, contacts=(), surface=None)),
            None if surface is None else surface.sha256,
            np.array(values, dtype=np.float64).reshape(-1, 27),
            np.concatenate([np.empty((2, 0)), *answers], axis=1),
            tuple(contact.pose for contact in contacts),
        )

    def contacts(self) -> list[Contact]:
        """Unpack the contacts."""
        found, end = list[Contact](), 0
        for row, pose in zip(self.values, self.poses, strict=True):
            start, end = end, end + int(row[1])
            channels, responses = self.answers[:, start:end]
            own = row[4:7], row[7:10], channels.astype(np.int64), responses, row[10:26].reshape(4, 4)
            found.append(Contact(int(row[0]), float(row[2]), float(row[3]), *own, pose, float(row[26]), final=True))
        return found

    def loaded(self) -> tuple[Surface | None, ModuleModel | None]:
        """Load mesh and modules, once for all reviews of a part; `InputError` if the mesh is gone or has changed."""
        scene = self.request.rig.scene
        key = pickle.dumps((self.mesh_sha256, scene.surface, scene.skin, scene.distances))
        if key not in _loaded:
            surface, _ = load_scene_surface(scene)
            if surface is not None and scene.surface is not None and surface.sha256 != self.mesh_sha256:
                raise InputError(f"{scene.surface.path}: the mesh changed since the session was opened; open it again.")
            _loaded.clear()
            _loaded[key] = surface, _model_of(scene, surface)
        return _loaded[key]


_loaded: dict[bytes, tuple[Surface | None, ModuleModel | None]] = {}
"""Mesh and modules of the newest part that this process has reviewed."""


class _GivenUpError(Exception):
    """A newer request waits."""


def review_sent(sent: SentReview, is_wanted: Callable[[], bool]) -> Review | None:
    """Do the review that another process requested; `None` if a newer request stopped it.

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
        surface, model = sent.loaded()
        rig = replace(sent.request.rig, contacts=sent.contacts(), surface=surface)
        return review_rig(replace(sent.request, rig=rig), between, model)
    except _GivenUpError:
        return None
