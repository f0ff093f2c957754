"""Results of a session, as commands, report and window show and export them: verdicts, rig diagnosis, layout check."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cached_property

from skincal.files.calibration import Calibration
from skincal.following.review import ReviewRequest, diagnose_rig
from skincal.following.session_guide import SessionGuide
from skincal.following.tool_check import check_tool_setup
from skincal.guide.verdict import Verdict
from skincal.methods import leading_method
from skincal.model.errors import InputError
from skincal.modules.health import LayoutRepair, count_judged_modules, repair_layout
from skincal.part.part import Part, lay_part
from skincal.rig.correction import FRAME
from skincal.rig.correction_fit import RigAnswer
from skincal.rig.frame_check import FrameDiagnosis
from skincal.rig.setup_check import SetupDiagnosis
from skincal.session.corrections import offered
from skincal.session.pipeline import Pipeline
from skincal.session.session import Session
from skincal.session.skin_findings import session_skin_sentences
from skincal.session.snapshot import Snapshot
from skincal.session.tool_sentences import session_tool_sentences
from skincal.taxels.result import Estimate, Method
from skincal.words.mistake_words import frame_sentence
from skincal.words.rig_words import rig_sentences
from skincal.words.verdict_words import verdict_sentence


def use_offered(session: Session) -> None:
    """Use the corrections that landmark pokes offer, the frame first, for `--correct`; the recording does not change.

    Raises InputError: there are no such pokes, they offer nothing, or they do not say for sure what is wrong with the frame.
    """
    if not len(session.landmark_pokes):
        raise InputError(
            "--correct needs pokes at landmarks; this session has none. `skincal landmarks` says which pokes were at landmarks."
        )
    has_arm = session.scene.arm is not None
    frame, rig = diagnose_rig(ReviewRequest.from_session(session))
    # A frame's correction changes the rig's, so both are found again after each.
    while (action := offered(frame, rig, len(session.landmark_pokes), session.decisions.corrections)) is not None:
        # Each kind once, else this might never end.
        if action.of in session.decisions.corrections:
            break
        if action.of == FRAME and frame is not None and not frame.sure:
            unsure = "Another mistake is nearly as likely; expected pokes at more landmarks."
            raise InputError(f"{frame_sentence(frame, has_arm=has_arm)} {unsure}")
        session.act(action)
        frame, rig = diagnose_rig(ReviewRequest.from_session(session))
    if not session.decisions.corrections:
        if frame is not None and frame.wrench_frame and not frame.right:
            raise InputError(f"{frame_sentence(frame, has_arm=has_arm)} Leave out --correct until then.")
        raise InputError(f"{rig_sentences(rig, has_arm=has_arm)[0]} Leave out --correct.")


class SessionResults:
    """Results of a recorded session, each computed once, when it is first used; the session must not change meanwhile."""

    def __init__(self, pipeline: Pipeline) -> None:
        self.pipeline, self.session = pipeline, pipeline.session
        self.snapshot = pipeline.snapshot()
        self._verdicts: dict[Method, Verdict] = {}

    @cached_property
    def part(self) -> Part:
        """The part as the scene describes it."""
        return lay_part(self.session.scene, self.session.surface, self.pipeline.findings)

    @cached_property
    def _rig_diagnosis(self) -> tuple[FrameDiagnosis | None, RigAnswer | None]:
        if not self.session.scene.has_sensor or not len(self.session.landmark_pokes):
            return None, None
        return diagnose_rig(ReviewRequest.from_session(self.session))

    @property
    def frame(self) -> FrameDiagnosis | None:
        """Diagnosis of the sensor frame; `None` from too few landmark pokes."""
        return self._rig_diagnosis[0]

    @property
    def rig(self) -> RigAnswer | None:
        """Fitted rig correction; `None` without landmark pokes."""
        return self._rig_diagnosis[1]

    @cached_property
    def setup(self) -> SetupDiagnosis | None:
        """Mistakes of the scene that pokes on the skin show; `None` without a laid layout, or with too few pokes."""
        session, part = self.session, self.part
        order = self.snapshot.value_order
        if order is not None and order.is_wrong:
            # The answers are those of other taxels: they say nothing about the scene.
            return None
        return check_tool_setup(self.snapshot, session.scene, part.laid, session.surface, session.wrench_frames)

    @cached_property
    def tool(self) -> tuple[str, ...]:
        """Sentences on a tool's tip, on the part's pose in the base of its poses, and on their delay; empty for other rigs."""
        return session_tool_sentences(self.snapshot, self.session.scene, self.pipeline.totals().pose_delays)

    @cached_property
    def skin(self) -> tuple[str, ...]:
        """Sentences on faults of the skin; empty without one."""
        totals = self.pipeline.totals()
        return session_skin_sentences(self.snapshot, totals.skin, self.session.scene, totals.pose_delays)

    @cached_property
    def leading(self) -> Method | None:
        """Method with the smallest predicted error; `None` if no taxel is estimated."""
        return leading_method(self.snapshot.estimates)

    def choose_method(self, asked: Method | None) -> Method:
        """Choose the requested method, else the leading one.

        Raises InputError: the scene lacks what the method needs.
        """
        chosen = asked or self.leading or self.session.methods[-1]
        if chosen not in self.snapshot.estimates:
            lacks = "surface" if chosen is Method.SURFACE else "layout"
            known = " or ".join(method.value for method in self.snapshot.estimates)
            raise InputError(f"The scene has no {lacks}; expected --method {known}.")
        return chosen

    def verdict(self, method: Method) -> Verdict:
        """Judge the calibration of one method."""
        if method not in self._verdicts:
            self._verdicts[method] = self._guide.verdict(self.snapshot, method, self.rig)
        return self._verdicts[method]

    @cached_property
    def _guide(self) -> SessionGuide:
        return SessionGuide(self.part)

    @cached_property
    def layout_repair(self) -> LayoutRepair | None:
        """Modules whose positions contradict the layout; `None` without a layout."""
        model = self.session.module_model
        return None if model is None else repair_layout(model, self._judging)

    @cached_property
    def modules_judged(self) -> int:
        """Number of modules with enough taxels to compare them with the layout."""
        model = self.session.module_model
        return 0 if model is None else count_judged_modules(model, self._judging)

    @property
    def _judging(self) -> dict[int, Estimate]:
        """Estimates by channel that do not use the layout: of the surface method if there is one."""
        known = self.snapshot.estimates
        return {estimate.channel: estimate for estimate in known.get(Method.SURFACE) or known.get(Method.FREE, ())}

    def calibration(self) -> Calibration:
        """Build the calibration that files are written from, with the verdict on every method."""
        verdicts = {method: self.verdict(method) for method in self.snapshot.estimates}
        return checked(self.session.calibration(), self.rig, verdicts)


def verdicts_of(part: Part, snapshot: Snapshot, methods: Sequence[Method], rig: RigAnswer | None) -> dict[Method, Verdict]:
    """Judge the calibration of each method, in any thread, since only the snapshot is read.

    `rig` is the fitted rig correction; `None` if it was not computed, or there are no landmark pokes.
    """
    guide, apart = SessionGuide(part), snapshot.detached()
    return {method: guide.verdict(apart, method, rig) for method in methods}


def checked(calibration: Calibration, rig: RigAnswer | None, verdicts: Mapping[Method, Verdict]) -> Calibration:
    """Add the verdicts and the check of the rig correction to a calibration."""
    return replace(
        calibration,
        rig=rig,
        verdicts={method: verdict_sentence(verdict).rstrip(".") for method, verdict in verdicts.items()},
        unmodelled_rig_error_m={method: verdict.unchecked for method, verdict in verdicts.items()},
    )
