"""`solve` and `export`: from a recorded session to estimates, calibration files and a corrected layout.

Slow imports are inside the functions that need them: `--help` must answer at once.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, TypeAlias

import typer

from skincal.files.consumers import consumers_help
from skincal.files.formats import ExportFormat, ExportOptions, Inertia, formats_help
from skincal.model.errors import InputError
from skincal.taxels.result import Method

if TYPE_CHECKING:
    from skincal.following.results import SessionResults
    from skincal.geometry import FloatArray
    from skincal.modules.distances import TriedDistance
    from skincal.rig.tip_frame import TipFrame
    from skincal.taxels.result import Estimate

    Estimates: TypeAlias = Mapping[Method, tuple[Estimate, ...]]

Json = Annotated[bool, typer.Option("--json", help="Print the result as JSON.")]
Replay = Annotated[
    bool, typer.Option("--replay", help="Decode and judge the recorded bytes again, instead of using the recorded pokes.")
]
Part = Annotated[
    str | None,
    typer.Option(help="Skin part named in the iCub file, such as r_forearm; default: the beginning of the scene's link name."),
]
Prefix = Annotated[
    str | None,
    typer.Option(
        help='Begins the names of taxels in urdf, tactile-urdf, sdf and mjcf; "" for none. Default: the link and an '
        "underscore, so that two skins of one robot share no name.",
        show_default=False,
    ),
]
Correct = Annotated[
    bool,
    typer.Option("--correct", help="Apply the corrections of sensor frame and rig that the landmark pokes support."),
]
LayoutOption = Annotated[
    Path | None,
    typer.Option(
        "--layout",
        help="Layout (*.modules.toml; lengths in mm, angles in degrees) in place of the session's own. The "
        "recorded pokes are used; with --replay they are judged again, too.",
        show_default=False,
    ),
]
SessionArgument = Annotated[Path, typer.Argument(help="Folder of a session.", show_default=False)]


MethodOption = Annotated[
    Method | None,
    typer.Option(
        help="Method whose positions are written. Default: the smallest predicted error, among the methods "
        "that know at least 95 % as many taxels as the best.",
        show_default=False,
    ),
]


def add_to(app: typer.Typer) -> None:
    """Add the commands of this module."""
    app.command(epilog="Example: skincal solve my-session --out results")(solve)
    purpose = (
        f"Write the calibration file of a session.\n\nFormats:\n\n{formats_help()}\n\nFormat for a program:\n\n"
        f"{consumers_help()}"
    )
    app.command(help=purpose, epilog="Example: skincal export my-session --format icub --out right_forearm.txt")(export)


def solve(
    session: SessionArgument,
    out: Annotated[Path | None, typer.Option(help="Folder for the calibration in every format.")] = None,
    reference: Annotated[
        Path | None, typer.Option(help="Known positions (truth.json or iCub position file) to compute the error against.")
    ] = None,
    per_pose: Annotated[
        bool, typer.Option("--per-pose", help="Also solve each arm pose alone and average the results, as the paper does.")
    ] = False,
    layout_out: Annotated[
        Path | None,
        typer.Option(
            help="File for the corrected layout, if modules are mirrored, turned or swapped. An older file is "
            "kept as .bak, .bak-2, .... The original layout is not changed. Without a finding nothing is written.",
            show_default=False,
        ),
    ] = None,
    layout: LayoutOption = None,
    correct: Correct = False,
    part: Part = None,
    prefix: Prefix = None,
    replay: Replay = False,
    as_json: Json = False,
) -> None:
    """Estimate every taxel of a session by each method of its scene.

    The method with the smallest predicted error comes first, among those that know at least 95 % as many taxels as the best.
    """
    from skincal.cli import output
    from skincal.files.reference import read_reference
    from skincal.interface.session import Session
    from skincal.words.layout_words import sheet_findings

    _check_file_options(out, part, prefix)
    known = None if reference is None else read_reference(reference)
    results = Session.load(session, layout=layout, replayed=replay, correct=correct).results
    pipeline, snapshot = results.pipeline, results.snapshot
    counts = output.poke_counts(snapshot)
    uncompared = output.uncompared_findings(snapshot, known)
    methods = _method_summaries(results, None if uncompared else known, per_pose=per_pose)
    of_rig, rig_lines = _skin_and_rig_result(results)
    leads = None if results.leading is None else results.leading.value
    verdict = None if results.leading is None else output.verdict_words(results.verdict(results.leading))
    unchecked = results.verdict(results.choose_method(None)).unchecked
    # Before the calibration is written: this file may be refused.
    modules, module_lines = _layout_result(results, layout, layout_out)
    files, written = ([], []) if out is None else _write_all(results, out, ExportOptions(part=part, prefix=prefix))
    sheets = sheet_findings(pipeline.scene.skin.layout, is_on_mesh=pipeline.session.surface is not None)
    findings = [*uncompared, *pipeline.findings, *sheets, *written]
    totals = pipeline.totals()
    losses = output.loss_counts(totals.links, totals.unpaired)
    result = {
        "session": session,
        **counts,
        "methods": methods,
        "leads": leads,
        "verdict": verdict,
        **of_rig,
        "unchecked_rig_mm": None if unchecked is None else unchecked * 1e3,
        "distances": [_distance(tried) for tried in snapshot.tried_distances],
        "dead": {str(channel): why for channel, why in snapshot.dead.items()},
        **losses,
        **modules,
        "files": files,
        "findings": findings,
    }
    text = [*output.poke_lines(counts, pipeline.scene), *output.method_lines(methods, leads), *rig_lines]
    text += [*output.unchecked_lines(results, unchecked), *_session_lines(results)]
    text += [] if verdict is None else [f"{verdict}."]
    text += [*module_lines, *(f"channel {channel} is not used: {why}" for channel, why in snapshot.dead.items())]
    text += [*output.loss_lines(totals.links), *findings, *(f"wrote {path}" for path in files)]
    output.print_result(result, text, as_json)


def _check_file_options(out: Path | None, part: str | None, prefix: str | None) -> None:
    """Refuse options of files without a folder for them."""
    if out is not None:
        return
    if part is not None:
        raise InputError("--part names the skin part in the iCub files; expected --out FOLDER to write them to.")
    if prefix is not None:
        raise InputError("--prefix begins the names of taxels in the files; expected --out FOLDER to write them to.")


def _skin_and_rig_result(results: SessionResults) -> tuple[dict[str, Any], list[str]]:
    """Describe the skin, the setup, the rig with its tip, and the turns of taxels, as JSON and in lines."""
    from skincal.cli import output
    from skincal.words.frame_words import frame_sentences
    from skincal.words.mistake_words import setup_sentences

    snapshot = results.snapshot
    setup = (*frame_sentences(results.session.wrench_frames, snapshot.contacts), *setup_sentences(results.setup))
    rig, rig_lines = _rig_result(results)
    has_tool = results.pipeline.scene.tool is not None
    tip, tip_lines = _tool_result(results) if has_tool else _tip_result(snapshot.tip_frame)
    turns, turn_lines = output.turn_result(results)
    known = {name: found for name, found in {"rig": rig, "tip": tip, "turns": turns}.items() if found}
    return {"skin": results.skin, "setup": setup, **known}, [*results.skin, *setup, *rig_lines, *tip_lines, *turn_lines]


def _method_summaries(results: SessionResults, known: Mapping[int, FloatArray] | None, *, per_pose: bool) -> dict[str, Any]:
    """Summarize each method as JSON, also with the available correction, and with `per_pose` for each arm pose alone."""
    from skincal.cli import output

    planned = results.pipeline.scene.skin.layout, results.snapshot.part_size
    methods = output.method_summaries(results.snapshot.estimates, known, *planned)
    if per_pose:
        methods |= output.method_summaries(_averages_over_poses(results), known, *planned, "-per-pose")
    if (found := _estimates_if_corrected(results)) is not None:
        methods |= output.method_summaries(found, known, *planned, "-corrected")
    return methods


def _distance(tried: TriedDistance) -> dict[str, Any]:
    """Convert a known distance and its estimate from pokes to JSON."""
    lengths = {"told_mm": tried.distance.length, "found_mm": tried.found, "sd_mm": tried.sd}
    in_mm = {key: None if value is None else value * 1e3 for key, value in lengths.items()}
    return {"taxels" if tried.distance.of_taxels else "modules": tried.distance.ends, "use": tried.use.value, **in_mm}


def _averages_over_poses(results: SessionResults) -> Estimates:
    from skincal.methods import average_over_poses

    session = results.session
    asked = session.contacts, session.channels
    rest = session.scene.noise, session.surface, session.module_model, session.shared_errors
    return {method: tuple(average_over_poses(*asked, method, *rest).values()) for method in session.methods}


def _layout_result(results: SessionResults, used: Path | None, out: Path | None) -> tuple[dict[str, Any], list[str]]:
    """Compare the layout with the estimates, as JSON and in lines; write the corrected layout to `out` if it is given."""
    from skincal.files.layout_file import write_layout
    from skincal.words.layout_words import change_words, left_sentences, misfit_sentence

    lines = [] if used is None else [f"solved with the layout {used} in place of the session's"]
    layout: dict[str, Any] = {"used": used, "changes": [], "left": [], "written": None}
    repair, model = results.layout_repair, results.session.module_model
    if repair is None or model is None:
        if out is not None:
            raise InputError(
                "--layout-out corrects a layout, and the scene has none; expected modules in its [skin], or --layout."
            )
        return {"misfits": [], "layout": layout}, lines
    if repair.changes and out is not None:
        write_layout(model.layout, repair, out)
        layout["written"] = out
    misfits = [misfit_sentence(misfit) for misfit in repair.misfits]
    layout["changes"] = [{"module": change.module, **change.keys} for change in repair.changes]
    layout["left"] = left_sentences(repair)
    lines += [*misfits, *layout["left"]]
    changes = "; ".join(change_words(change) for change in repair.changes)
    if changes and out is not None:
        lines += [f"corrected {changes}", f"wrote {out}; `skincal solve SESSION --layout {out}` solves with it"]
    elif changes:
        lines.append(f"the corrected layout says {changes}; --layout-out FILE writes it")
    elif out is not None:
        lines.append(f"{out} is not written: {_no_change_reason(results, misfits)}")
    return {"misfits": misfits, "layout": layout}, lines


def _no_change_reason(results: SessionResults, misfits: Sequence[str]) -> str:
    if misfits:
        return "nothing that was found can be put right by it"
    judged = results.modules_judged
    return f"none of {judged} modules looks mirrored, turned or swapped" if judged else "too little is known of every module"


def _session_lines(results: SessionResults) -> list[str]:
    """List the known distances that are used and the result of the last final check, in lines."""
    from skincal.session.closing_pokes import closings_of
    from skincal.words.layout_words import distance_sentences
    from skincal.words.rig_words import closing_sentence, earlier_closings

    closings = closings_of(results.snapshot, results.session.scene.noise)
    has_tool = results.session.scene.tool is not None
    final = [closing_sentence(closings[-1], has_tool=has_tool), *earlier_closings(closings)] if closings else []
    return [*distance_sentences(results.snapshot.tried_distances), *final]


def _tip_result(frame: TipFrame | None) -> tuple[dict[str, Any], list[str]]:
    """Summarise the use of the tip's positions, as JSON and in lines; both empty without them."""
    if frame is None:
        return {}, []
    from skincal.rig.tip_frame import TipState
    from skincal.words.tip_words import tip_sentence

    words = tip_sentence(frame)
    summary: dict[str, Any] = {"used": frame.state is TipState.USED, "state": frame.state.value, "pokes": frame.pokes}
    if summary["used"]:
        summary |= {"tip_sd_mm": frame.tip_sd * 1e3, "base_sd_mm": frame.shift_sd * 1e3}
        summary["base_sd_deg"] = math.degrees(frame.turn_sd)
    return summary | {"words": words}, [words]


def _tool_result(results: SessionResults) -> tuple[dict[str, Any], list[str]]:
    """Summarise the tip of a tool and the part's pose in the base, as JSON and in lines."""
    frame, part = results.snapshot.tip_frame, results.snapshot.part_pose
    summary: dict[str, Any] = {"words": results.tool}
    if frame is not None:
        summary |= {"state": frame.state.value, "pokes": frame.pokes}
    if part is not None:
        summary["part"] = {
            "state": part.state.value,
            "sd_mm": part.sd * 1e3,
            "base_from_link": part.base_from_link.tolist(),
            "landmarks": part.landmarks,
            "taxels": part.taxels,
            "points": part.points,
        }
    return summary, list(results.tool)


def _rig_result(results: SessionResults) -> tuple[dict[str, Any], list[str]]:
    """Summarise what landmark pokes say of sensor and arm, as JSON and in lines; both empty without such pokes."""
    from skincal.words.mistake_words import frame_sentence
    from skincal.words.rig_words import rig_error_sentences

    frame, answer, used = results.frame, results.rig, results.session.decisions.corrections
    if answer is None:
        return {}, []
    has_arm = results.session.scene.arm is not None
    rig: dict[str, Any] = {"landmark_pokes": len(results.session.landmark_pokes), "used": answer.used}
    rig["corrections"] = [
        {"of": each.of, "before_mm": each.before * 1e3, "after_mm": each.after * 1e3} for each in used.values()
    ]
    if frame is not None:
        words = frame_sentence(frame, has_arm=has_arm)
        rig["frame"] = {"right": frame.right, "sure": frame.sure, "miss_mm": frame.miss * 1e3, "words": words}
    if answer.correction is not None:
        rig |= {"held_out_before_mm": answer.before * 1e3, "held_out_after_mm": answer.after * 1e3}
        rig["held_out_over_predicted"] = answer.ratio
        rig["noise_over_scene"] = answer.noisier
        rig["doubted"] = {str(poke): trust for poke, trust in answer.trust.items() if trust < 1.0}
    return rig, rig_error_sentences(frame, used, answer, has_arm=has_arm)


def _estimates_if_corrected(results: SessionResults) -> Estimates | None:
    """Estimate the taxels under the offered correction; `None` without an offer, or if it is in use."""
    from skincal.methods import estimate_taxels
    from skincal.rig.correction import RIG, CorrectionErrors

    session, correction = results.session, None if results.rig is None else results.rig.usable
    if correction is None or RIG in session.decisions.corrections:
        return None
    contacts = [correction.corrected(contact) for contact in session.rig_request().contacts]
    noise, surface, model = session.scene.noise, session.surface, session.module_model
    shared = CorrectionErrors(correction, {contact.poke: contact for contact in contacts}.__getitem__)
    solved = estimate_taxels(
        contacts, session.channels, session.methods, noise, surface, session.dead, model=model, shared=shared
    )
    return {method: tuple(estimates.values()) for method, estimates in solved.items()}


def _write_all(results: SessionResults, folder: Path, options: ExportOptions) -> tuple[list[Path], list[str]]:
    """Write every format for every method of the scene; return the files and the findings, each once."""
    from skincal.files.export import write_calibration

    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"{folder}: cannot be made ({error.strerror}); choose another folder.") from None
    calibration = results.calibration()
    files: list[Path] = []
    findings: dict[str, None] = {}
    for format_ in ExportFormat:
        if format_.needs_three_axes and calibration.axes is None:
            continue
        stem = "positions" if format_ is ExportFormat.ICUB else "taxels"
        for method in list(calibration.estimates)[: 1 if format_.holds_all_methods else None]:
            name = "calibration" if format_.holds_all_methods else f"{stem}-{method.value}"
            files.append(folder / f"{name}{format_.suffix}")
            chosen = replace(options.for_format(format_), is_asked=False)
            findings |= dict.fromkeys(write_calibration(calibration, format_, files[-1], method, chosen))
    # `solve` says these anyway.
    return files, [sentence for sentence in findings if sentence not in calibration.tool]


def export(
    session: SessionArgument,
    format_: Annotated[ExportFormat, typer.Option("--format", help="Format of the file; see above.")],
    out: Annotated[Path, typer.Option(help="File to write; an older one is kept as .bak, .bak-2, ...")],
    method: MethodOption = None,
    layout: LayoutOption = None,
    correct: Correct = False,
    part: Part = None,
    prefix: Prefix = None,
    inertia: Annotated[
        Inertia,
        typer.Option(
            help="Mass of each taxel's link in urdf: none, or tiny (1e-6 kg, 1e-12 kg m2) for programs that give 1 kg to a "
            "link without mass (PyBullet, urchin)."
        ),
    ] = Inertia.NONE,
    into: Annotated[
        Path | None,
        typer.Option(
            help="Robot's own file (.urdf for urdf and tactile-urdf, .sdf for sdf): the whole robot with the taxels is "
            "written to --out, and this file stays unchanged.",
            show_default=False,
        ),
    ] = None,
    replay: Replay = False,
    as_json: Json = False,
) -> None:
    """Write the calibration file of a session."""
    from skincal.cli import output
    from skincal.interface.session import Session

    options = ExportOptions(part, prefix, inertia, into)
    options.require_use(format_)
    opened = Session.load(session, layout=layout, replayed=replay, correct=correct)
    results, chosen = opened.results, opened.results.choose_method(method)
    findings = [*opened.findings, *opened.export(out, format_.value, chosen.value, options)]
    snapshot, judged = results.snapshot, results.verdict(chosen)
    summary = output.method_summary(snapshot.estimates[chosen], None, results.session.scene.skin.layout, snapshot.part_size)
    line = output.method_line(chosen.value, summary) + (output.LEADS_WORDS if chosen is results.leading else "")
    verdict, unchecked = output.verdict_words(judged), judged.unchecked
    result = {
        "file": out,
        "format": format_.value,
        "method": chosen.value,
        **({} if layout is None else {"layout": layout}),
        **({} if into is None else {"into": into}),
        **summary,
        "leads": None if results.leading is None else results.leading.value,
        "verdict": verdict,
        "unchecked_rig_mm": None if unchecked is None else unchecked * 1e3,
        "findings": findings,
    }
    text = [line, *output.unchecked_lines(results, unchecked), f"{verdict}.", *findings, f"wrote {out}"]
    output.print_result(result, text, as_json)
