"""Collects all data of a report. `page.py` formats it."""

from __future__ import annotations

import platform
import sys
import time
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from importlib.metadata import PackageNotFoundError, version

import numpy as np

from skincal.contacts.outcome import Reason, Rejection
from skincal.files.export import calibration_file
from skincal.files.formats import ExportFormat, ExportOptions
from skincal.files.reference import ErrorSummary, TaxelPositions, error_summary
from skincal.following.error_history import ErrorCourse, ErrorSeries, spreads_of
from skincal.following.results import SessionResults
from skincal.geometry import FloatArray
from skincal.guide.verdict import Verdict
from skincal.methods import estimate_taxels
from skincal.modules.health import spacing_ratio
from skincal.part.part import Part
from skincal.session.landmark_pokes import misses_of_landmarks
from skincal.session.pipeline import Pipeline
from skincal.session.session import Session
from skincal.session.snapshot import Snapshot
from skincal.taxels.gains import TaxelGain
from skincal.taxels.result import Estimate, Method
from skincal.taxels.shared_errors import PredictedError, known_error, predicted_error
from skincal.version import __version__

REPORTED_PACKAGES = ("numpy", "scipy", "wasmtime", "mcap", "zstandard", "matplotlib", "jinja2")
"""Packages whose versions a report shows, since its numbers, files or pictures depend on them."""


@dataclass(frozen=True, slots=True)
class MethodFacts:
    """Results of one method."""

    method: Method
    states: Mapping[str, int]
    """Taxels by the name of their state."""
    predicted: PredictedError | None
    """`None` if no taxel is estimated."""
    error: ErrorSummary | None
    """Against the truth; `None` if it is unknown."""
    spacing: float | None
    """Measured over planned distance of neighbours; `None` without a layout."""
    solve_s: float
    """s of processor time to solve all taxels from all pokes on this machine."""


@dataclass(frozen=True, slots=True, eq=False)
class SessionFacts:
    """Everything that a report shows of a session, by one method."""

    name: str
    """Name of its folder."""
    made: datetime
    """Time of the report, UTC."""
    results: SessionResults
    method: Method
    """Method whose estimates are shown: the requested one, else the leading one."""
    methods: tuple[MethodFacts, ...]
    errors: Mapping[int, float]
    """m, by channel, of the estimated taxels: distance to the truth if it is known, else predicted error."""
    module_spreads: FloatArray
    """(modules, 4) float: of `errors`, see `spreads_of`; no rows without a layout."""
    gains: tuple[TaxelGain, ...]
    """In the order of the estimates."""
    truth: TaxelPositions | None
    """True positions of a simulated rig; `None` for a real one."""
    series: ErrorSeries
    """`errors` over the session, by every method."""
    misses: Mapping[str, tuple[float, ...]]
    """m, by landmark: distances of its pokes, as the rig reports them (`misses_of_landmarks`)."""
    rejected: Mapping[Reason, tuple[Rejection, ...]]
    """Rejected pokes that are not at landmarks, by reason, the most frequent first."""
    lint: tuple[str, ...]
    """Findings in the iCub position file, as it would be written."""
    versions: Mapping[str, str]

    @property
    def estimates(self) -> tuple[Estimate, ...]:
        """Estimates of `method`."""
        return self.results.snapshot.estimates[self.method]

    @property
    def verdict(self) -> Verdict:
        """Verdict on `method`."""
        return self.results.verdict(self.method)


def gather_facts(results: SessionResults, name: str, truth: TaxelPositions | None, method: Method) -> SessionFacts:
    """Gather everything that a report shows; the parameters are fields of `SessionFacts`."""
    session, snapshot, pokes = results.session, results.snapshot, results.session.landmark_pokes
    if not snapshot.is_placed:  # positions are in the base, truth and landmarks in the part's frame
        truth, pokes = None, pokes[:0]
    misses = misses_of_landmarks(pokes, session.contact_at)
    calibration, errors = session.calibration(), errors_of(snapshot.estimates[method], truth, snapshot.part_size)
    names = [mark.name for mark in session.decisions.landmarks]
    return SessionFacts(
        name=name,
        made=datetime.now(UTC),
        results=results,
        method=method,
        methods=tuple(_method_facts(session, snapshot, each, truth) for each in session.methods),
        errors=errors,
        module_spreads=_module_spreads(results.pipeline, errors),
        gains=calibration.gains(method),
        truth=truth,
        series=_series(results.part, snapshot, truth),
        misses={mark: tuple(misses[pokes.name == mark].tolist()) for mark in names},
        rejected=_rejected(snapshot),
        lint=calibration_file(calibration, ExportFormat.ICUB, method, ExportOptions(is_asked=False))[1],
        versions=_versions(),
    )


def errors_of(estimates: tuple[Estimate, ...], truth: TaxelPositions | None, part_size: float) -> dict[int, float]:
    """Compute the error of each estimated taxel, metres by channel: against the truth, or without one the known error."""
    if truth is None:
        errors = ((estimate.channel, known_error(estimate, part_size)) for estimate in estimates)
        return {channel: error for channel, error in errors if error is not None}
    return {
        estimate.channel: float(np.linalg.norm(estimate.position - truth.places[estimate.channel]))
        for estimate in estimates
        if estimate.position is not None and estimate.channel in truth.places
    }


def _method_facts(session: Session, snapshot: Snapshot, method: Method, truth: TaxelPositions | None) -> MethodFacts:
    estimates, layout = snapshot.estimates[method], session.scene.skin.layout
    names = [estimate.state.value for estimate in estimates]
    begun = time.process_time()
    rest = session.scene.noise, session.surface, session.dead
    # With the shared errors of a correction, as the session solves.
    shared = session.shared_errors
    estimate_taxels(session.contacts, session.channels, (method,), *rest, model=session.module_model, shared=shared)
    return MethodFacts(
        method,
        {name: names.count(name) for name in dict.fromkeys(names)},
        predicted_error(estimates, snapshot.part_size),
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


def _series(part: Part, snapshot: Snapshot, truth: TaxelPositions | None) -> ErrorSeries:
    course = ErrorCourse(part.scene, part.surface, None if truth is None else truth.places)
    course.update(snapshot)
    course.add_points(*course.work())
    return course.series()


def _rejected(snapshot: Snapshot) -> dict[Reason, tuple[Rejection, ...]]:
    # No taxel answers a poke at a landmark, which is no fault.
    outcomes = [
        record.outcome
        for record in snapshot.pokes
        if record.outcome.poke not in snapshot.at_landmarks and not snapshot.is_taken_out(record)
    ]
    every = [outcome for outcome in outcomes if isinstance(outcome, Rejection)]
    of = {reason: tuple(each for each in every if each.reason is reason) for reason in Reason}
    return dict(sorted(((reason, found) for reason, found in of.items() if found), key=lambda item: -len(item[1])))


def _versions() -> dict[str, str]:
    found = {"skincal": __version__, "Python": platform.python_version(), "system": f"{platform.system()} {platform.machine()}"}
    for package in REPORTED_PACKAGES:
        try:
            found[package] = version(package)
        except PackageNotFoundError:
            # A frozen program has packages without metadata.
            found[package] = str(getattr(sys.modules.get(package), "__version__", "unknown"))
    return found
