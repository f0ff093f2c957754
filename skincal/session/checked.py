"""A session's calibration together with what was checked of it: what the command line and the window write alike."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

from skincal.files.calibration import Calibration, landmark_check
from skincal.rig.correction_fit import RigAnswer
from skincal.session.guiding import SessionGuide
from skincal.session.part import lay_part
from skincal.session.session import Session
from skincal.taxels.result import Method


def verdicts_of(session: Session, methods: Sequence[Method], rig: RigAnswer | None) -> dict[Method, str]:
    """Return by method what a session has come to: `SessionGuide.verdicts` for a session that nobody guides.

    `rig` is what landmark pokes say; None where nobody has looked, or there are none.
    """
    guide = SessionGuide(lay_part(session.scene, session.surface, ()))
    return guide.verdicts(session.snapshot(), methods, session.evidence, rig)


def checked_calibration(session: Session, rig: RigAnswer | None, verdicts: Mapping[Method, str] | None = None) -> Calibration:
    """Return what the files are written from, with what landmark pokes say of a correction of the rig, and the verdicts.

    Parameters
    ----------
    rig : what landmark pokes say; None where nobody has looked, or there are none
    verdicts : by method, where they are known already
    """
    words = verdicts_of(session, session.methods, rig) if verdicts is None else verdicts
    return replace(session.calibration(), landmark_check=None if rig is None else landmark_check(rig), verdicts=words)
