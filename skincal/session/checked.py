"""A session's calibration with its checks and corrections, for commands, report and window."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

from skincal.files.calibration import Calibration, landmark_check
from skincal.guide.verdict import Verdict
from skincal.model.errors import InputError
from skincal.rig.correction import FRAME
from skincal.rig.correction_fit import RigAnswer
from skincal.session.corrections import offered
from skincal.session.guiding import SessionGuide
from skincal.session.part import Part, lay_part
from skincal.session.review import ReviewRequest, diagnose_rig
from skincal.session.session import Session
from skincal.session.snapshot import Snapshot
from skincal.taxels.contact_table import ContactTable
from skincal.taxels.result import Method
from skincal.words.rig_words import frame_sentence, rig_sentences
from skincal.words.verdict_words import verdict_sentence


def use_offered(session: Session) -> None:
    """Use the corrections that landmark pokes offer, the frame first, for `--correct`; the recording does not change.

    `InputError` if there are no such pokes, they offer nothing, or the frame's mistake is not sure.
    """
    if not session.landmark_pokes:
        raise InputError(
            "--correct needs pokes at landmarks; this session has none. `skincal landmarks` says which pokes were at landmarks."
        )
    frame, rig = diagnose_rig(ReviewRequest.of(session))
    # A frame's correction changes the rig's, so both are found again after each.
    while (action := offered(frame, rig, len(session.landmark_pokes), session.decisions.corrections)) is not None:
        # Each kind once, else this might never end.
        if action.of in session.decisions.corrections:
            break
        if action.of == FRAME and frame is not None and not frame.sure:
            raise InputError(f"{frame_sentence(frame)} Another mistake is nearly as likely; expected pokes at more landmarks.")
        session.act(action)
        frame, rig = diagnose_rig(ReviewRequest.of(session))
    if not session.decisions.corrections:
        raise InputError(f"{rig_sentences(rig)[0]} Leave out --correct.")


def verdicts_of(part: Part, snapshot: Snapshot, methods: Sequence[Method], rig: RigAnswer | None) -> dict[Method, Verdict]:
    """Judge a session by each method from its snapshot, in any thread; `rig` is the fit to its landmark pokes."""
    if part.cover is not None and part.surface is not None:
        from skincal.guide.surface_search import SurfaceSearch

        # A guide writes into it, and another may use the part's own at the same time.
        part = replace(part, cover=SurfaceSearch(part.surface))
    guide, evidence = SessionGuide(part), ContactTable(snapshot.contacts).evidence
    return {method: guide.verdict(snapshot, method, evidence, rig) for method in methods}


def words_of(verdicts: Mapping[Method, Verdict]) -> dict[Method, str]:
    """Put verdicts into words for `Calibration.verdicts`."""
    return {method: verdict_sentence(verdict).rstrip(".") for method, verdict in verdicts.items()}


def checked(calibration: Calibration, rig: RigAnswer | None, verdicts: Mapping[Method, Verdict]) -> Calibration:
    """Add the check by landmark pokes and the verdicts to a calibration."""
    found = None if rig is None else landmark_check(rig)
    unchecked = {method: verdict.unchecked for method, verdict in verdicts.items()}
    return replace(calibration, landmark_check=found, verdicts=words_of(verdicts), unmodelled_rig_error_m=unchecked)


def checked_calibration(session: Session, rig: RigAnswer | None, methods: Sequence[Method] | None = None) -> Calibration:
    """Gather a session's calibration with its checks; `methods` limits the verdicts."""
    part, chosen = lay_part(session.scene, session.surface, ()), session.methods if methods is None else methods
    return checked(session.calibration(), rig, verdicts_of(part, session.snapshot(), chosen, rig))
