"""What a report tells of a session: values of the core, gathered once; the page only puts them into words and lines."""

from __future__ import annotations

import platform
import sys
import time
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

import numpy as np

from skincal import __version__
from skincal.contacts.outcome import Reason, Rejection
from skincal.files.calibration import Calibration
from skincal.files.export import calibration_file
from skincal.files.formats import ExportFormat
from skincal.files.reference import ErrorSummary, Reference, error_summary, find_truth
from skincal.geometry import FloatArray
from skincal.guide.verdict import Verdict
from skincal.journal.documents import Totals
from skincal.methods import estimate_taxels, leading_method
from skincal.model.errors import InputError
from skincal.modules.health import LayoutRepair, count_judged_modules, repair_layout, spacing_ratio
from skincal.rig.correction_fit import RigAnswer
from skincal.rig.frame_check import FrameDiagnosis
from skincal.session.checked import use_offered, verdicts_of
from skincal.session.error_history import ErrorCourse, ErrorSeries, spreads_of
from skincal.session.part import Part, lay_part
from skincal.session.pipeline import Pipeline
from skincal.session.replay import load
from skincal.session.review import ReviewRequest, diagnose_rig
from skincal.session.session import Session
from skincal.session.snapshot import Snapshot
from skincal.streams.links import LinkSpec
from skincal.taxels.gains import TaxelGain
from skincal.taxels.result import Estimate, Method
from skincal.taxels.shared_errors import PredictedError, predicted_error

PACKAGES = ("numpy", "scipy", "wasmtime", "mcap", "zstandard", "matplotlib", "jinja2")
"""Those whose versions a report tells: they have a part in its numbers, its files or its pictures."""


@dataclass(frozen=True, slots=True)
class MethodFacts:
    """What one method has come to."""

    method: Method
    states: Mapping[str, int]
    """Taxels by the name of their state."""
    predicted: PredictedError | None
    """None where no taxel is known."""
    error: ErrorSummary | None
    """Against the truth; None where that is not known."""
    spacing: float | None
    """How far neighbours lie apart over how far the layout plans it; None without a layout."""
    solve_s: float
    """s of processor time that it took here to solve all taxels from all pokes."""


@dataclass(frozen=True, slots=True, eq=False)
class SessionFacts:
    """A session as it stands, by one method."""

    name: str
    """Of its folder."""
    made: datetime
    """When this was gathered, UTC."""
    part: Part
    snapshot: Snapshot
    method: Method
    """Whose estimates are shown: the one asked for, else the one that leads."""
    methods: tuple[MethodFacts, ...]
    estimates: tuple[Estimate, ...]
    """Of `method`."""
    errors: Mapping[int, float]
    """m, by channel, of the taxels that are known: their distance to the truth where that is known, else predicted."""
    module_spreads: FloatArray
    """(modules, 4) float: of `errors`, see `spreads_of`; no rows without a layout."""
    gains: tuple[TaxelGain, ...]
    """In the order of `estimates`."""
    truth: Reference | None
    """A simulated rig's; None of a real one."""
    series: ErrorSeries
    """How `errors` fell over the session, by every method."""
    verdict: Verdict
    frame: FrameDiagnosis | None
    """What landmark pokes say of the sensor's frame; None from too few."""
    rig: RigAnswer | None
    """What they say of the rig; None without any."""
    misses: Mapping[str, tuple[float, ...]]
    """m, by landmark: how far its pokes pass it as the rig reports them."""
    mend: LayoutRepair | None
    """Modules that do not lie as planned; None without a layout."""
    judged: int
    """Modules of which enough is known for that."""
    rejected: Mapping[Reason, tuple[Rejection, ...]]
    """Pokes on the skin that do not count, by reason, the most frequent first."""
    links: tuple[LinkSpec, ...]
    totals: Totals
    lint: tuple[str, ...]
    """What was found in the iCub position file as it would be written."""
    findings: tuple[str, ...]
    """On the recording and on the mesh."""
    versions: Mapping[str, str]


def gather_facts(folder: Path, method: Method | None = None, *, correct: bool = False) -> SessionFacts:
    """Load a recorded session and gather what a report tells; nothing in the folder changes.

    Parameters
    ----------
    method : whose estimates are shown; None for the one that leads
    correct : whether the corrections that landmark pokes offer are used (`use_offered`)

    Raises
    ------
    InputError
        The folder is no session, its scene does not have the method, or no correction is offered.
    """
    pipeline = load(folder)
    if correct:
        use_offered(pipeline.session)
    session, snapshot = pipeline.session, pipeline.snapshot()
    chosen = method or leading_method(snapshot.estimates) or session.methods[-1]
    if chosen not in snapshot.estimates:
        raise InputError(f"{folder}: has no {chosen.value} method; expected {', '.join(m.value for m in session.methods)}.")
    part = lay_part(pipeline.scene, session.surface, pipeline.findings)
    truth = find_truth(folder, pipeline.scene.link, part.channels.tolist())
    estimates, calibration = snapshot.estimates[chosen], session.calibration()
    errors = errors_of(estimates, truth)
    frame, rig = diagnose_rig(ReviewRequest.of(session)) if session.landmark_pokes else (None, None)
    mend, judged = _modules(session, snapshot)
    return SessionFacts(
        name=folder.resolve().name,
        made=datetime.now(UTC),
        part=part,
        snapshot=snapshot,
        method=chosen,
        methods=tuple(_method_facts(session, snapshot, each, truth) for each in session.methods),
        estimates=estimates,
        errors=errors,
        module_spreads=_module_spreads(pipeline, errors),
        gains=calibration.gains(chosen),
        truth=truth,
        series=_series(part, snapshot, truth),
        verdict=verdicts_of(part, snapshot, (chosen,), rig)[chosen],
        frame=frame,
        rig=rig,
        misses=_misses(session),
        mend=mend,
        judged=judged,
        rejected=_rejected(snapshot),
        links=pipeline.links,
        totals=pipeline.totals(),
        lint=_lint(calibration, chosen),
        findings=pipeline.findings,
        versions=_versions(),
    )


def errors_of(estimates: tuple[Estimate, ...], truth: Reference | None) -> dict[int, float]:
    """Return the error of each taxel that is known, metres by channel: against the truth, or without one the predicted."""
    if truth is None:
        return {estimate.channel: estimate.rms for estimate in estimates if estimate.rms is not None}
    return {
        estimate.channel: float(np.linalg.norm(estimate.position - truth.places[estimate.channel]))
        for estimate in estimates
        if estimate.position is not None and estimate.channel in truth.places
    }


def _method_facts(session: Session, snapshot: Snapshot, method: Method, truth: Reference | None) -> MethodFacts:
    estimates, layout = snapshot.estimates[method], session.scene.skin.layout
    names = [estimate.state.value for estimate in estimates]
    begun = time.process_time()
    rest = session.scene.noise, session.surface, session.dead
    # With the errors that a correction makes all contacts share: that is the work the session does.
    shared = session.shared_errors
    estimate_taxels(session.contacts, session.channels, (method,), *rest, model=session.module_model, shared=shared)
    return MethodFacts(
        method,
        {name: names.count(name) for name in dict.fromkeys(names)},
        predicted_error(estimates),
        None if truth is None else error_summary(estimates, truth.places),
        None if layout is None else spacing_ratio(layout, estimates),
        time.process_time() - begun,
    )


def _module_spreads(pipeline: Pipeline, errors: Mapping[int, float]) -> FloatArray:
    layout = pipeline.scene.skin.layout
    if layout is None:
        return np.empty((0, 4))
    channels = np.array(list(errors), dtype=np.int64)
    return spreads_of(np.array(list(errors.values())), layout.module_of[channels], len(layout.modules))


def _series(part: Part, snapshot: Snapshot, truth: Reference | None) -> ErrorSeries:
    course = ErrorCourse(part.scene, part.surface, None if truth is None else truth.places)
    course.update(snapshot)
    course.add_points(*course.work())
    return course.series()


def _misses(session: Session) -> dict[str, tuple[float, ...]]:
    pokes = session.landmark_pokes
    return {mark.name: tuple(poke.miss for poke in pokes if poke.name == mark.name) for mark in session.decisions.landmarks}


def _modules(session: Session, snapshot: Snapshot) -> tuple[LayoutRepair | None, int]:
    """Return which modules do not lie as planned, by the surface method where there is one, and how many were judged."""
    if session.module_model is None:
        return None, 0
    of = snapshot.estimates.get(Method.SURFACE) or snapshot.estimates[Method.FREE]
    estimates = {estimate.channel: estimate for estimate in of}
    return repair_layout(session.module_model, estimates), count_judged_modules(session.module_model, estimates)


def _rejected(snapshot: Snapshot) -> dict[Reason, tuple[Rejection, ...]]:
    # A poke at a landmark is not meant for the skin: that no taxel answered is no fault there.
    outcomes = [record.outcome for record in snapshot.pokes if record.outcome.poke not in snapshot.at_landmarks]
    every = [outcome for outcome in outcomes if isinstance(outcome, Rejection)]
    of = {reason: tuple(each for each in every if each.reason is reason) for reason in Reason}
    return dict(sorted(((reason, found) for reason, found in of.items() if found), key=lambda item: -len(item[1])))


def _lint(calibration: Calibration, method: Method) -> tuple[str, ...]:
    return calibration_file(calibration, ExportFormat.ICUB.value, method)[1]


def _versions() -> dict[str, str]:
    found = {"skincal": __version__, "Python": platform.python_version(), "system": f"{platform.system()} {platform.machine()}"}
    for package in PACKAGES:
        try:
            found[package] = version(package)
        except PackageNotFoundError:
            # A program that was frozen carries packages without their papers.
            found[package] = str(getattr(sys.modules.get(package), "__version__", "unknown"))
    return found
