"""`solve` and `export`: from a recorded session to estimates, calibration files and a corrected layout.

Slow imports are inside the functions that need them: `--help` must answer at once.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from skincal.files.formats import ExportFormat, formats_help
from skincal.model.errors import InputError
from skincal.taxels.result import Method

if TYPE_CHECKING:
    from skincal.files.calibration import Calibration
    from skincal.geometry import FloatArray
    from skincal.model.scene import Scene
    from skincal.modules.distances import TriedDistance
    from skincal.modules.health import LayoutRepair
    from skincal.rig.correction_fit import RigAnswer
    from skincal.session.pipeline import Pipeline
    from skincal.session.session import Session
    from skincal.session.snapshot import Snapshot

Json = Annotated[bool, typer.Option("--json", help="Print the result as JSON.")]
Replay = Annotated[
    bool, typer.Option("--replay", help="Play the recorded bytes again instead of taking the pokes as they were judged.")
]
Part = Annotated[
    str | None,
    typer.Option(help="Skin part named in the iCub file, such as r_forearm; else the one that the scene's link begins with."),
]
Correct = Annotated[
    bool,
    typer.Option("--correct", help="Use the corrections of the sensor's frame and of the rig that landmark pokes offer."),
]
LayoutFile = Annotated[
    Path | None,
    typer.Option(
        "--layout",
        help="Layout (*.modules.toml; lengths in mm, angles in degrees) in place of the session's own. Pokes stay as they were "
        "judged; with --replay they are judged anew, too.",
        show_default=False,
    ),
]
SessionArgument = Annotated[Path, typer.Argument(help="Folder of a session.", show_default=False)]


MethodOption = Annotated[
    Method | None,
    typer.Option(
        help="Whose positions to write; else those of the method that predicts the smallest error, among the methods that "
        "know at least 95 % of the taxels that any one knows.",
        show_default=False,
    ),
]


def add_to(app: typer.Typer) -> None:
    """Add the commands of this module."""
    app.command(epilog="Example: skincal solve my-session --out results")(solve)
    told = f"Write the calibration file of a session.\n\nFormats:\n\n{formats_help()}"
    app.command(help=told, epilog="Example: skincal export my-session --format icub --out right_forearm.txt")(export)


def solve(
    session: SessionArgument,
    out: Annotated[Path | None, typer.Option(help="Folder for the calibration in every format.")] = None,
    reference: Annotated[
        Path | None, typer.Option(help="Known places, a truth.json or an iCub position file: report the error against them.")
    ] = None,
    per_pose: Annotated[
        bool, typer.Option("--per-pose", help="Also solve each arm pose alone and average the results, as the paper does.")
    ] = False,
    layout_out: Annotated[
        Path | None,
        typer.Option(
            help="File for the corrected layout where modules are mirrored, turned or swapped in the layout; an older one is "
            "kept as .bak, .bak-2, ...; the layout that was read is not touched. Nothing is written where nothing is wrong.",
            show_default=False,
        ),
    ] = None,
    layout: LayoutFile = None,
    correct: Correct = False,
    part: Part = None,
    replay: Replay = False,
    as_json: Json = False,
) -> None:
    """Estimate every taxel of a session by each method of its scene.

    The method that predicts the smallest error comes first, among those that know 95 % of the taxels that any one knows.
    """
    from skincal.cli import report
    from skincal.files.reference import read_reference
    from skincal.session.checked import use_offered

    if part is not None and out is None:
        raise InputError("--part names the skin part in the iCub files; expected --out FOLDER to write them to.")
    known = None if reference is None else read_reference(reference)
    pipeline = _opened(session, replay, layout)
    if correct:
        use_offered(pipeline.session)
    solved, text = _solved(pipeline, known, per_pose=per_pose)
    # Before anything is written: its file may be refused.
    modules, module_lines = _layout_result(pipeline.session, layout, layout_out)
    files, written = ([], []) if out is None else _write_all(pipeline, out, part)
    findings = [*pipeline.findings, *written]
    totals = pipeline.totals()
    losses = report.loss_counts(totals.links, totals.unpaired)
    text += [*module_lines, *(f"channel {channel} is not used: {why}" for channel, why in solved["dead"].items())]
    text += [*report.loss_lines(losses), *findings, *(f"wrote {path}" for path in files)]
    result = {"session": session, **solved, **losses, **modules, "files": files, "findings": findings}
    report.print_result({**result, "text": text}, as_json)


def _solved(pipeline: Pipeline, known: Mapping[int, FloatArray] | None, *, per_pose: bool) -> tuple[dict[str, Any], list[str]]:
    """Summarise the estimates of a session's pokes, as JSON and in lines."""
    from skincal.cli import report

    session, snapshot = pipeline.session, pipeline.snapshot()
    counts = report.poke_counts(snapshot)
    methods = report.method_summaries(snapshot.estimates, known, session.scene.skin.layout)
    if per_pose:
        methods |= _per_pose(pipeline, known)
    rig, rig_lines, unchecked = _corrected(pipeline, known)
    methods |= rig.pop("methods", {})
    leads = report.leading_name(snapshot.estimates)
    verdict = None if leads is None else _verdict(session, Method(leads))
    text = [*report.poke_lines(counts), *report.method_lines(methods, leads)]
    text += [*rig_lines, *_session_lines(snapshot, session.scene), *([] if verdict is None else [f"{verdict}."])]
    result = {
        **counts,
        "methods": methods,
        "leads": leads,
        "verdict": verdict,
        **({"rig": rig} if rig else {}),
        "unchecked_rig_mm": None if unchecked is None else unchecked * 1e3,
        "distances": [_distance(tried) for tried in snapshot.tried_distances],
        "dead": {str(channel): why for channel, why in snapshot.dead.items()},
    }
    return result, text


def _distance(tried: TriedDistance) -> dict[str, Any]:
    """Return a known distance, and what pokes say of it, as JSON."""
    lengths = {"told_mm": tried.distance.length, "found_mm": tried.found, "sd_mm": tried.sd}
    in_mm = {key: None if value is None else value * 1e3 for key, value in lengths.items()}
    return {"taxels" if tried.distance.of_taxels else "modules": tried.distance.ends, "use": tried.use.value, **in_mm}


def _opened(session: Path, from_bytes: bool, layout: Path | None) -> Pipeline:
    from skincal.session.replay import load, replay

    return (replay if from_bytes else load)(session, layout)


def _per_pose(pipeline: Pipeline, known: Mapping[int, FloatArray] | None) -> dict[str, Any]:
    from skincal.cli import report
    from skincal.methods import average_over_poses

    session = pipeline.session
    asked = session.contacts, session.channels
    rest = session.scene.noise, session.surface, session.module_model, session.shared_errors
    averaged = {method: tuple(average_over_poses(*asked, method, *rest).values()) for method in session.methods}
    return report.method_summaries(averaged, known, session.scene.skin.layout, "-per-pose")


def _layout_result(session: Session, used: Path | None, out: Path | None) -> tuple[dict[str, Any], list[str]]:
    """Compare the layout with the estimates, as JSON and in lines; write the corrected layout to `out` if it is given.

    Modules are judged by the estimates of the surface method where there is one, else by those of free.
    """
    from skincal.files.layout_file import write_layout
    from skincal.modules.health import count_judged_modules, repair_layout
    from skincal.words.layout_words import left_sentences, misfit_sentence

    lines = [] if used is None else [f"solved with the layout {used} in place of the session's"]
    result: dict[str, Any] = {"misfits": [], "layout": {"used": used, "changes": [], "left": [], "written": None}}
    if session.module_model is None:
        if out is not None:
            raise InputError(
                "--layout-out corrects a layout, and the scene has none; expected modules in its [skin], or --layout."
            )
        return result, lines
    known = session.snapshot().estimates
    estimates = {estimate.channel: estimate for estimate in known.get(Method.SURFACE) or known.get(Method.FREE, ())}
    mend = repair_layout(session.module_model, estimates)
    written = out if mend.changes else None
    if written is not None:
        write_layout(session.module_model.layout, mend, written)
    misfits = [misfit_sentence(misfit) for misfit in mend.misfits]
    changes = [{"module": change.module, **change.keys} for change in mend.changes]
    layout = {"used": used, "changes": changes, "left": left_sentences(mend), "written": written}
    lines += [*misfits, *_mend_lines(mend, out, count_judged_modules(session.module_model, estimates))]
    return {"misfits": misfits, "layout": layout}, lines


def _session_lines(snapshot: Snapshot, scene: Scene) -> list[str]:
    """List the known distances that are used and the result of the last drift check, in lines."""
    from skincal.session.closing_pokes import closings_of
    from skincal.words.layout_words import distance_sentences
    from skincal.words.rig_words import closing_sentence, earlier_closings

    closings = closings_of(snapshot, scene.noise)
    told = [closing_sentence(closings[-1]), *earlier_closings(closings)] if closings else []
    return [*distance_sentences(snapshot.tried_distances), *told]


def _mend_lines(mend: LayoutRepair, out: Path | None, judged: int) -> list[str]:
    """Return the lines on the correction, without the misfits themselves."""
    from skincal.words.layout_words import change_words, left_sentences

    changes, left = "; ".join(change_words(change) for change in mend.changes), left_sentences(mend)
    if mend.changes and out is not None:
        return [*left, f"corrected {changes}", f"wrote {out}; `skincal solve SESSION --layout {out}` solves with it"]
    if mend.changes:
        return [*left, f"the corrected layout says {changes}; --layout-out FILE writes it"]
    if out is None:
        return left
    found = f"none of {judged} modules looks mirrored, turned or swapped" if judged else "too little is known of every module"
    why = "nothing that was found can be put right by it" if mend.misfits else found
    return [*left, f"{out} is not written: {why}"]


def _corrected(pipeline: Pipeline, known: Mapping[int, FloatArray] | None) -> tuple[dict[str, Any], list[str], float | None]:
    """Return (json, lines, unmodelled error in metres) of the rig correction from landmark pokes.

    Without such pokes the JSON is empty. Where no correction is in use, the estimates under the one that was found stand beside
    the others.
    """
    session = pipeline.session
    if not session.landmark_pokes:
        return {}, *_unchecked(session, None)
    from skincal.cli import report
    from skincal.methods import estimate_taxels
    from skincal.rig.correction import RIG, CorrectionErrors
    from skincal.session.review import ReviewRequest, diagnose_rig
    from skincal.words.rig_words import correction_sentence, frame_sentence, rig_sentences

    frame, answer = diagnose_rig(ReviewRequest.of(session))
    rig: dict[str, Any] = {"landmark_pokes": len(session.landmark_pokes), "used": answer.used}
    rig["corrections"] = [
        {"of": used.of, "before_mm": used.before * 1e3, "after_mm": used.after * 1e3}
        for used in session.decisions.corrections.values()
    ]
    if frame is not None:
        words = frame_sentence(frame)
        rig["frame"] = {"right": frame.right, "sure": frame.sure, "miss_mm": frame.miss * 1e3, "words": words}
    if answer.correction is not None:
        rig |= {"held_out_before_mm": answer.before * 1e3, "held_out_after_mm": answer.after * 1e3}
        rig["held_out_over_predicted"] = answer.ratio
        rig["noise_over_scene"] = answer.noisier
        rig["doubted"] = {str(poke): trust for poke, trust in answer.trust.items() if trust < 1.0}
    if answer.used and answer.correction is not None and RIG not in session.decisions.corrections:
        contacts = [answer.correction.corrected(contact) for contact in session.rig_request().contacts]
        noise, surface, model = session.scene.noise, session.surface, session.module_model
        shared = CorrectionErrors(answer.correction, {contact.poke: contact for contact in contacts}.__getitem__)
        solved = estimate_taxels(
            contacts, session.channels, session.methods, noise, surface, session.dead, model=model, shared=shared
        )
        found = {method: tuple(estimates.values()) for method, estimates in solved.items()}
        rig["methods"] = report.method_summaries(found, known, session.scene.skin.layout, "-corrected")
    lines = [] if frame is None else [frame_sentence(frame)]
    lines += [correction_sentence(used) for used in session.decisions.corrections.values()]
    lines += rig_sentences(answer)[1 if RIG in session.decisions.corrections else 0 :]
    unchecked_lines, unchecked = _unchecked(session, answer)
    return rig, [*lines, *unchecked_lines], unchecked


def _unchecked(session: Session, answer: RigAnswer | None) -> tuple[list[str], float | None]:
    """Return by how much the rig's errors may move the taxels beside what is predicted, by the method that leads.

    In lines and in metres.

    Parameters
    ----------
    answer : what landmark pokes say
    """
    from skincal.methods import leading_method
    from skincal.rig.correction import RIG
    from skincal.rig.correction_fit import landmark_agreement
    from skincal.rig.expected_gain import unchecked_of
    from skincal.words.taxel_words import unchecked_sentence

    known = session.snapshot().estimates
    used, estimates = session.decisions.corrections.get(RIG), known[leading_method(known) or session.methods[-1]]
    landmarks, noise = landmark_agreement(answer, used), session.scene.noise
    off = unchecked_of(used, landmarks, estimates, session.contacts, session.landmark_pokes, noise)
    return ([] if off is None else [unchecked_sentence(off, len(session.landmark_pokes))]), off


def _rig_answer(session: Session) -> RigAnswer | None:
    """Fit the rig correction to the landmark pokes; `None` without such pokes."""
    from skincal.rig.correction_fit import correct_rig

    return correct_rig(session.rig_request()) if session.landmark_pokes else None


def _verdict(session: Session, method: Method) -> str:
    """Judge a method's calibration, in a sentence without its full stop."""
    from skincal.session.checked import checked_calibration

    return checked_calibration(session, _rig_answer(session), [method]).verdicts[method]


def _write_all(pipeline: Pipeline, folder: Path, part: str | None) -> tuple[list[Path], list[str]]:
    """Write every format for every method of the scene; return the files and the findings."""
    from skincal.files.export import write_calibration
    from skincal.session.checked import checked_calibration

    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"{folder}: cannot be made ({error.strerror}); choose another folder.") from None
    calibration = checked_calibration(pipeline.session, _rig_answer(pipeline.session))
    methods = tuple(calibration.estimates)
    names: list[tuple[str, str, Method]] = []
    for format_ in ExportFormat:
        stem = "positions" if format_ is ExportFormat.ICUB else "taxels"
        own = [(format_.value, f"{stem}-{method.value}{format_.suffix}", method) for method in methods]
        names += [(format_.value, f"calibration{format_.suffix}", methods[0])] if format_.holds_all_methods else own
    # Several formats of the same calibration have the same faults, which are said once.
    findings: dict[str, None] = {}
    for format_, name, method in names:
        findings |= dict.fromkeys(write_calibration(calibration, format_, folder / name, method, part))
    return [folder / name for _, name, _ in names], list(findings)


def calibration_of(
    session: Path, replay: bool, layout: Path | None, correct: bool, method: Method | None
) -> tuple[Pipeline, Calibration, Method]:
    """Open a session; return it with its calibration and the method to write: the given one or else the best."""
    from skincal.methods import leading_method
    from skincal.session.checked import checked_calibration, use_offered

    pipeline = _opened(session, replay, layout)
    if correct:
        use_offered(pipeline.session)
    calibration = checked_calibration(pipeline.session, _rig_answer(pipeline.session))
    chosen = method or leading_method(calibration.estimates) or pipeline.session.methods[-1]
    if chosen not in calibration.estimates:
        lacks = "surface" if chosen is Method.SURFACE else "layout"
        known = " or ".join(method.value for method in calibration.estimates)
        raise InputError(f"{session}: its scene has no {lacks}; expected --method {known}.")
    return pipeline, calibration, chosen


def export(
    session: SessionArgument,
    format_: Annotated[ExportFormat, typer.Option("--format", help="Format of the file; see above.")],
    out: Annotated[Path, typer.Option(help="File to write; an older one is kept as .bak, .bak-2, ...")],
    method: MethodOption = None,
    layout: LayoutFile = None,
    correct: Correct = False,
    part: Part = None,
    replay: Replay = False,
    as_json: Json = False,
) -> None:
    """Write the calibration file of a session."""
    from skincal.cli import report
    from skincal.files.export import write_calibration
    from skincal.methods import leading_method
    from skincal.words.taxel_words import unchecked_sentence

    if part is not None and format_ is not ExportFormat.ICUB:
        raise InputError(f"--part names the skin part in an iCub file; expected --format icub, not {format_.value}.")
    pipeline, calibration, chosen = calibration_of(session, replay, layout, correct, method)
    leads = leading_method(calibration.estimates)
    findings = [*pipeline.findings, *write_calibration(calibration, format_.value, out, chosen, part)]
    summary = report.method_summary(calibration.estimates[chosen], None, pipeline.session.scene.skin.layout)
    used = {} if layout is None else {"layout": layout}
    lead = report.LEADS if chosen is leads else ""
    verdict, off = calibration.verdicts[chosen], calibration.unmodelled_rig_error_m[chosen]
    unchecked = [] if off is None else [unchecked_sentence(off, len(pipeline.session.landmark_pokes))]
    text = [report.method_line(chosen, summary) + lead, *unchecked, f"{verdict}.", *findings, f"wrote {out}"]
    result = {"file": out, "format": format_.value, "method": chosen.value, **used, **summary}
    result |= {"leads": report.leading_name(calibration.estimates), "verdict": verdict}
    result |= {"unchecked_rig_mm": None if off is None else off * 1e3, "findings": findings}
    report.print_result({**result, "text": text}, as_json)
