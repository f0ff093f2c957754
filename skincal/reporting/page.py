"""Format a report as one HTML file with all its pictures.

Names come from untrusted files and devices, so the template escapes all text, and the page forbids a browser to run or to fetch
anything.
"""

from __future__ import annotations

import math
import re
from base64 import b64encode
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

from skincal.files.atomic import write_atomically
from skincal.files.export import CONTACT_UNITS, NOISE_UNITS
from skincal.following.error_history import MAX, MEAN, P95, TAXELS
from skincal.guide.progress import GuideSettings
from skincal.model.errors import list_channels, plural
from skincal.model.tool_rig import BASE_LINK
from skincal.reporting.drawings import VIEW_NAMES, draw_course, draw_map, draw_sides, error_name
from skincal.reporting.session_facts import MethodFacts, SessionFacts
from skincal.taxels.gains import TaxelGain
from skincal.taxels.result import Estimate
from skincal.taxels.shared_errors import PredictedError
from skincal.words.frame_words import frame_sentences
from skincal.words.layout_words import distance_sentences, left_sentences, misfit_sentence
from skincal.words.link_words import beside_words, outage_words
from skincal.words.mistake_words import frame_sentence, setup_sentences
from skincal.words.poke_words import poke_count_words, reason_words
from skincal.words.rig_words import rig_error_sentences
from skincal.words.taxel_words import NOT_KNOWN_YET, state_sentence, taxel_error_words, unchecked_sentence
from skincal.words.units import DASH, millimetres
from skincal.words.verdict_words import check_words, closing_words, figures, landmark_figure, left_words, verdict_sentence

_INVISIBLE_CHARACTER_RE = re.compile("[\x00-\x08\x0b-\x1f\x7f-\x9f\u200b-\u200f\u202a-\u202e\u2060-\u2069\ud800-\udfff\ufeff]")
_NUMBER_RE = re.compile(rf"-?[\d.]+|{DASH}")
AGREES, AGAINST, OPEN = "agrees", "contradicts", "not checked"
"""Results of a check of the verdict; the template colours the first two."""
CHECK_FIGURES = ("Test pokes", "Landmarks", "Final check")
"""Figures of the verdict that are rows of its evidence."""
COLOUR_NOTE = (
    f"The darker, the larger the error: the scale reaches to {1e3 * GuideSettings().wanted:g} mm, the wanted error, or to the "
    "worst twentieth if that is larger."
)
MAX_LISTED_CHANNEL_RANGES = 40
"""More ranges of channels in a cell are counted."""
GUIDE_UNITS = {
    "wanted": "m", "module_wanted": "m", "diversity": "rad", "balance": "m", "settled": "m", "usable_tilt": "rad",
    "tolerance": "rad", "unknown": "m", "hand_speed": "m/s",
}  # fmt: skip
"""Units of the guide's settings; others are plain numbers, or seconds if the name ends in `_s`."""
SHOWN_UNITS = {"Nm": "N m"}
"""Units that are shown in another way than in the exported keys."""


@dataclass(frozen=True, slots=True)
class ReportTable:
    """A table of a section."""

    headings: Sequence[str]
    rows: Sequence[Sequence[str]]
    caption: str = ""
    small: bool = False
    """Set a long table in small type."""
    judged: bool = False
    """Colour the verdicts in the last column."""

    @property
    def numeric(self) -> tuple[bool, ...]:
        """Whether each column holds only numbers and dashes, and is not the first; such columns are right-aligned."""
        columns = enumerate(zip(*self.rows, strict=True))
        return tuple(
            index > 0 and set(column) != {DASH} and all(map(_NUMBER_RE.fullmatch, column)) for index, column in columns
        )


@dataclass(frozen=True, slots=True)
class ReportPicture:
    """A picture of a section, as a `data:` address, and its description."""

    source: str
    words: str


@dataclass(frozen=True, slots=True)
class ReportSection:
    """A section of the page with its heading."""

    title: str
    sentences: Sequence[str] = ()
    pictures: Sequence[ReportPicture] = ()
    tables: Sequence[ReportTable] = ()


def write_report(facts: SessionFacts, path: Path) -> str:
    """Write the report and return its verdict; an older file is kept as `.bak`.

    Raises InputError: the file cannot be written.
    """
    write_atomically(path, report_page(facts).encode("utf-8"))
    return verdict_sentence(facts.verdict)


def report_page(facts: SessionFacts) -> str:
    """Format the page as HTML."""
    # The commands' help needs no template.
    from jinja2 import Environment, FileSystemLoader, StrictUndefined

    environment = Environment(
        loader=FileSystemLoader(Path(__file__).parent),
        autoescape=True,
        undefined=StrictUndefined,
        finalize=_visible,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    scene = facts.results.part.scene
    return environment.get_template("report.html.jinja").render(
        title=f"{scene.name} {DASH} {facts.name}",
        made=f"{facts.made:%Y-%m-%d %H:%M} UTC",
        simulated=facts.truth is not None,
        link=scene.link,
        method=facts.method.value,
        version=facts.versions["skincal"],
        verdict=verdict_sentence(facts.verdict),
        enough=facts.verdict.is_finished and not facts.verdict.doubted,
        sections=[section for make in SECTIONS if (section := make(facts)) is not None],
    )


def _visible(value: object) -> object:
    """Replace invisible characters, which may reverse the order of those that follow."""
    return _INVISIBLE_CHARACTER_RE.sub("\N{REPLACEMENT CHARACTER}", value) if isinstance(value, str) else value


# ---- the verdict and what it rests on ----


def _verdict(facts: SessionFacts) -> ReportSection:
    left = facts.verdict.left
    tables = [
        ReportTable(("", ""), [row for row in figures(facts.verdict) if row[0] not in CHECK_FIGURES]),
        ReportTable(("Check", "Result", "Verdict"), list(_evidence(facts)), "Evidence", judged=True),
    ]
    if left:
        rows = _group_channels((left_words(each), each.channel) for each in left)
        headings = ("Reason", "Number", "Taxels")
        tables.append(ReportTable(headings, rows, f"{plural(len(left), 'taxel')} not finished"))
    return ReportSection("Verdict and evidence", tables=tables)


def _group_channels(pairs: Iterable[tuple[str, int]]) -> list[tuple[str, str, str]]:
    """Group channels by their sentence; return rows of sentence, number and channels."""
    of: dict[str, list[int]] = {}
    for words, channel in pairs:
        of.setdefault(words, []).append(channel)
    return [(words, str(len(some)), list_channels(some, MAX_LISTED_CHANNEL_RANGES)) for words, some in of.items()]


def _evidence(facts: SessionFacts) -> Iterator[tuple[str, str, str]]:
    """Yield (check, result, verdict), also for checks that were not possible."""
    check, landmarks = facts.verdict.check, facts.verdict.landmarks
    said = AGREES if check.agrees else AGAINST
    yield "Test pokes", check_words(facts.verdict), said if check.has_enough or not check.believed else OPEN
    said = OPEN if landmarks is None or (landmarks.agrees and landmarks.driven) else AGREES
    said = said if landmarks is None or landmarks.agrees else AGAINST
    yield "Landmarks", landmark_figure(facts.verdict), said
    closings = facts.verdict.closings
    yield (
        "Final check",
        closing_words(closings, has_tool=facts.verdict.has_tool),
        AGAINST if facts.verdict.has_moved else AGREES if closings else OPEN,
    )
    frame = facts.results.frame
    if frame is None and facts.results.part.scene.has_sensor:
        yield "Sensor's frame", "not checked: it needs pokes at landmarks", OPEN
    elif frame is not None:
        yield "Sensor's frame", frame_sentence(frame, has_arm=facts.verdict.has_arm), AGREES if frame.right else AGAINST
    if frames := frame_sentences(facts.results.session.wrench_frames, facts.results.snapshot.contacts):
        yield "Wrench's frame", " ".join(frames), AGAINST if facts.verdict.frame_in_doubt else OPEN
    if skin := facts.results.skin:
        yield "Skin", " ".join(skin), AGAINST
    if setup := setup_sentences(facts.results.setup):
        yield "Scene and pokes", " ".join(setup), AGAINST
    yield "Modules as planned", *_module_evidence(facts)
    lint, findings = facts.lint, facts.results.part.findings
    yield "Exported file", "see the remarks below" if lint else "no remarks", plural(len(lint), "remark") if lint else AGREES
    lead = next(each for each in facts.methods if each.method is facts.method)
    if lead.error is None:
        yield "Truth", "not known: only a simulated rig tells where its taxels are", OPEN
    else:
        error = f"{_mm_text(lead.error.mean)} mean error, {_mm_text(lead.error.max)} largest"
        yield "Truth", f"simulated: {error}", "known"
    said = plural(len(findings), "remark") if findings else AGREES
    yield "Recording", " ".join(findings) or "read without damage", said


def _module_evidence(facts: SessionFacts) -> tuple[str, str]:
    repair, judged = facts.results.layout_repair, facts.results.modules_judged
    if repair is None:
        return "not checked: the scene has no layout", OPEN
    if repair.misfits:
        return " ".join(misfit_sentence(misfit) for misfit in repair.misfits), AGAINST
    if not judged:
        return "too little is known of every module", OPEN
    return f"none of {plural(judged, 'module')} looks mirrored, turned or swapped", AGREES


# ---- pictures and errors ----


def _part(facts: SessionFacts) -> ReportSection:
    if not facts.results.snapshot.is_placed:
        return ReportSection("The part", ("Positions are in the base until the part's pose is known: no picture shows them.",))
    words = f"The part from four sides ({', '.join(VIEW_NAMES)}), its taxels coloured by {error_name(facts)}."
    note = f"Each view shows the taxels of its side. {COLOUR_NOTE}"
    return ReportSection("The part", (note,), (_picture(draw_sides(facts), "png", words),))


def _map(facts: SessionFacts) -> ReportSection:
    layout = facts.results.part.scene.skin.layout
    if layout is None:
        return ReportSection("Map", ("The scene has no layout, so there is no map.",))
    words = f"The layout unrolled, its modules with their numbers, taxels coloured by {error_name(facts)}."
    note = f"Rings are taxels that are not located, crosses disabled ones. {COLOUR_NOTE}"
    return ReportSection("Map", (note,), (_picture(draw_map(facts, layout), "svg", words),))


def _errors(facts: SessionFacts) -> ReportSection:
    against = "against the truth" if facts.truth is not None else "as predicted, since the truth is not known"
    words = f"{error_name(facts).capitalize()} of each method against pokes, against time, and against what solving costs."
    tables = [ReportTable(METHOD_HEADINGS, [_method_row(each) for each in facts.methods], "Methods; lengths in mm")]
    if len(facts.module_spreads):
        tables.append(ReportTable(MODULE_HEADINGS, list(_module_rows(facts)), f"Modules; {error_name(facts)}, mm"))
    said = f"Errors are {against}; the table of taxels is at the end. Time is poking time, without long pauses."
    known = any((spreads[:, 0, TAXELS] > 0).any() for spreads in facts.series.spreads.values())
    pictures = (_picture(draw_course(facts), "svg", words),) if known else ()
    return ReportSection("Errors", (said if known else "No taxel is known yet.",), pictures, tables)


METHOD_HEADINGS = (
    "Method", "Taxels", "Predicted error, mean", "worst", "of it shared", "and single", "True error, mean", "sd",
    "95\N{NO-BREAK SPACE}%", "worst", "Neighbours / layout", "Solved in, ms",
)  # fmt: skip
MODULE_HEADINGS = ("Module", "Taxels known", "Mean", "95\N{NO-BREAK SPACE}%", "Worst")


def _method_row(each: MethodFacts) -> tuple[str, ...]:
    states = ", ".join(f"{count} {name}" for name, count in each.states.items())
    mean, *predicted = _predicted_cells(each.predicted)
    error = (None,) * 4 if each.error is None else (each.error.mean, each.error.sd, each.error.p95, each.error.max)
    lengths = (_mm_cell(length) for length in error)
    return each.method.value, states, mean, *predicted, *lengths, _number(each.spacing), f"{each.solve_s * 1e3:.1f}"


def _predicted_cells(found: PredictedError | None) -> list[str]:
    """Format the four lengths of a predicted error; taxels whose error is not known yet are counted in the first cell."""
    if found is None:
        return [_mm_cell(None)] * 4
    # Without a correction of the rig, the prediction has no part that all taxels share.
    shared = (found.whole, found.among) if found.whole else (None, None)
    cells = [_mm_cell(length) for length in (found.mean, found.worst, *shared)]
    if found.unknown:
        cells[0] = NOT_KNOWN_YET if math.isnan(found.mean) else f"{cells[0]} ({found.unknown} {NOT_KNOWN_YET})"
    return cells


def _module_rows(facts: SessionFacts) -> Iterator[tuple[str, ...]]:
    layout = facts.results.part.scene.skin.layout
    modules = () if layout is None else layout.modules
    for module, spread in sorted(zip(modules, facts.module_spreads, strict=True), key=lambda pair: pair[0].id):
        lengths = (_mm_cell(float(spread[column])) for column in (MEAN, P95, MAX))
        known = 0 if math.isnan(spread[TAXELS]) else int(spread[TAXELS])
        yield str(module.id), f"{known} of {len(module.channels)}", *lengths


def _taxels(facts: SessionFacts) -> ReportSection:
    pairs = list(zip(facts.estimates, facts.gains, strict=True))
    rows = [_taxel_row(facts, estimate, gain) for estimate, gain in pairs if estimate.position is not None]
    tables = [ReportTable(TAXEL_HEADINGS, rows, f"{plural(len(rows), 'taxel')} with a position", small=True)] if rows else []
    unknown = [estimate for estimate in facts.estimates if estimate.position is None]
    if unknown:
        why = _group_channels((_state_words(estimate), estimate.channel) for estimate in unknown)
        caption = f"{plural(len(unknown), 'taxel')} without a position"
        tables.append(ReportTable(("State and reason", "Number", "Taxels"), why, caption))
    note = (
        f"Positions are in the frame {_frame(facts)}. The sd is along the least certain direction. The gain is the response "
        "over the force along the normal, with its sd over the pokes in which the taxel answered most."
    )
    return ReportSection("Taxels", (note,), tables=tables)


def _frame(facts: SessionFacts) -> str:
    """Name the frame of all positions: the part's link, or the base while the part's pose is unknown."""
    return facts.results.part.scene.link if facts.results.snapshot.is_placed else BASE_LINK


def _state_words(estimate: Estimate) -> str:
    why = state_sentence(estimate.reason)
    return f"{estimate.state.value}: {why}" if why else estimate.state.value


TAXEL_HEADINGS = (
    "Module", "Taxel", "State", "Error, mm", "Predicted, mm", "sd, mm", "Contacts", "x, mm", "y, mm", "z, mm", "Gain, raw/N",
    "its sd", "Pokes",
)  # fmt: skip


def _taxel_row(facts: SessionFacts, estimate: Estimate, gain: TaxelGain) -> tuple[str, ...]:
    place = (None,) * 3 if estimate.position is None else estimate.position.tolist()
    layout, channel = facts.results.part.scene.skin.layout, estimate.channel
    index = -1 if layout is None else int(layout.module_of[channel])
    module = DASH if layout is None or index < 0 else str(layout.modules[index].id)
    true = facts.errors.get(channel) if facts.truth is not None else None
    predicted = taxel_error_words(estimate, facts.results.snapshot.part_size).removesuffix(" mm")
    return (
        module, str(channel), estimate.state.value, _mm_cell(true), predicted, _mm_cell(estimate.sd), str(estimate.contacts),
        *(_mm_cell(each) for each in place), _number(gain.mean), _number(gain.spread), str(gain.pokes),
    )  # fmt: skip


# ---- the rig, the pokes, the file, the devices ----


def _rig(facts: SessionFacts) -> ReportSection:
    used = facts.results.snapshot.decisions.corrections
    has_arm = facts.verdict.has_arm
    said = rig_error_sentences(facts.results.frame, used, facts.results.rig, has_arm=has_arm)
    poked, off = sum(len(misses) for misses in facts.misses.values()), facts.verdict.unchecked
    said = [*facts.results.tool, *said]
    said += [] if off is None else [unchecked_sentence(off, poked, has_arm=has_arm)]
    said += distance_sentences(facts.results.snapshot.tried_distances)
    rows = [
        (
            mark.name,
            *(_mm_cell(float(each)) for each in mark.place),
            str(len(facts.misses[mark.name])),
            ", ".join(f"{miss * 1e3:.1f}" for miss in facts.misses[mark.name]) or DASH,
        )
        for mark in facts.results.snapshot.decisions.landmarks
    ]
    headings = ("Landmark", "x, mm", "y, mm", "z, mm", "Pokes", "Misses, mm")
    tables = (ReportTable(headings, rows, "Landmarks, with pokes as reported by the rig"),) if rows else ()
    said += [] if rows else ["The scene names no landmarks."]
    return ReportSection("Rig and landmarks", said, tables=tables)


def _pokes(facts: SessionFacts) -> ReportSection:
    snapshot = facts.results.snapshot
    out = [str(record.outcome.poke) for record in snapshot.pokes if snapshot.is_taken_out(record)]
    said = [f"{poke_count_words(snapshot.poke_counts)}.", *([f"Excluded: poke {', '.join(out)}."] if out else [])]
    said += [f"Channel {channel} is not used: {why}." for channel, why in facts.results.snapshot.dead.items()]
    rows = [
        (reason_words(found[0]), str(len(found)), ", ".join(str(each.poke) for each in found))
        for found in facts.rejected.values()
    ]
    tables = (ReportTable(("Reason", "Pokes", "Their numbers"), rows, "Rejected pokes"),) if rows else ()
    return ReportSection("Pokes", said, tables=tables)


def _lint(facts: SessionFacts) -> ReportSection:
    head = f"The iCub position file of the {facts.method.value} method, checked as it would be written:"
    mend = () if facts.results.layout_repair is None else left_sentences(facts.results.layout_repair)
    return ReportSection("The exported file", (head, *(facts.lint or ("No remarks.",)), *mend))


def _devices(facts: SessionFacts) -> ReportSection:
    if not facts.results.pipeline.links:
        return ReportSection("Devices", ("The pokes are from arrays of a script, without devices and recording.",))
    totals = {link.link: link for link in facts.results.pipeline.totals().links}
    rows: list[tuple[str, ...]] = []
    for link in facts.results.pipeline.links:
        of, carries = totals.get(link.name), ", ".join(stream.value for stream in link.carries)
        lost = "" if of is None else ", ".join(f"{count} {loss.value}" for loss, count in of.losses.items() if count)
        lost = lost or "none"
        lost += "" if of is None or not of.outages.count else f"; {outage_words(of.outages)}"
        told = ("", "0") if of is None else (of.format, str(of.readings))
        beside = "" if of is None else beside_words(of.beside)
        rows.append((link.name, link.address, carries, *told, lost, beside or DASH))
    unpaired = facts.results.pipeline.totals().unpaired
    said = (
        f"{plural(unpaired, 'skin frame')} had no force/torque reading."
        if unpaired
        else "Every skin frame had a force/torque reading."
    )
    headings = ("Link", "Address", "Carries", "Format", "Readings", "Lost", "Other readings")
    return ReportSection("Devices", (said,), tables=(ReportTable(headings, rows),))


def _settings(facts: SessionFacts) -> ReportSection:
    scene = facts.results.part.scene
    arm = ("Arm poses", "none" if scene.arm is None else ", ".join(scene.arm.poses) or "streamed")
    if scene.tool is not None:
        arm = ("Tool", "streamed poses, sensor on the tool" if scene.tool.has_sensor else "streamed poses, no sensor")
    surface, layout = facts.results.part.surface, scene.skin.layout
    what = [
        ("Scene", scene.name), ("Scene file", scene.path.name), ("Frame of all positions", _frame(facts)),
        ("Channels of a skin frame", str(scene.skin.channels)),
        ("Modules", "no layout" if layout is None else str(len(layout.modules))), arm,
        ("Mesh", "none" if scene.surface is None else scene.surface.path.name),
        ("Triangles", "none" if surface is None else str(len(surface.triangles))),
        ("SHA-256 of the mesh", "none" if surface is None else surface.sha256),
    ]  # fmt: skip
    tables = [ReportTable(("", ""), what, "Scene")]
    changed = facts.results.snapshot.decisions.thresholds != scene.contacts
    thresholds = "Thresholds of a poke" + (", as they were changed in the session" if changed else "")
    for caption, settings, units in (
        (thresholds, facts.results.snapshot.decisions.thresholds, CONTACT_UNITS),
        ("Assumed noise", scene.noise, NOISE_UNITS),
        ("Limits of the guide", GuideSettings(), GUIDE_UNITS),
    ):  # fmt: skip
        tables.append(ReportTable(("Setting", "Value", "Unit"), list(_setting_rows(settings, units)), caption))
    return ReportSection("Settings", ("SI units, as in the scene file.",), tables=tables)


def _setting_rows(settings: Any, units: Mapping[str, str]) -> Iterator[tuple[str, str, str]]:
    for item in fields(settings):
        unit = units.get(item.name) or ("s" if item.name.endswith("_s") else "")
        yield item.name, f"{getattr(settings, item.name):g}", SHOWN_UNITS.get(unit, unit)


def _versions(facts: SessionFacts) -> ReportSection:
    return ReportSection("Versions", tables=(ReportTable(("", ""), list(facts.versions.items())),))


def _turns(facts: SessionFacts) -> ReportSection | None:
    """Make the section on taxels of three axes; `None` for others."""
    axes, found = facts.results.session.scene.skin.axes, facts.results.session.axis_results()
    if axes is None or found is None:
        return None
    from skincal.reporting.turn_section import (
        MODULE_TURN_HEADINGS,
        TURN_HEADINGS,
        module_turn_rows,
        turn_rows,
        turn_words_of,
    )

    modules, taxels = list(module_turn_rows(found)), list(turn_rows(facts, found))
    tables = [ReportTable(MODULE_TURN_HEADINGS, modules, "Modules; errors are standard deviations")] if modules else []
    if taxels:
        tables.append(ReportTable(TURN_HEADINGS, taxels, f"Axes of {plural(len(taxels), 'taxel')} in the link", small=True))
    return ReportSection("Turns of the taxels", turn_words_of(facts, found, axes), tables=tables)


SECTIONS: tuple[Callable[[SessionFacts], ReportSection | None], ...] = (
    _verdict, _part, _map, _errors, _rig, _pokes, _lint, _devices, _settings, _taxels, _turns, _versions,
)  # fmt: skip
"""In the order of the page; `None` leaves a section out."""


def _picture(data: bytes, kind: str, words: str) -> ReportPicture:
    mime = {"png": "image/png", "svg": "image/svg+xml"}[kind]
    return ReportPicture(f"data:{mime};base64,{b64encode(data).decode('ascii')}", words)


def _mm_text(metres: float) -> str:
    return millimetres(metres, 2)


def _mm_cell(metres: float | None) -> str:
    """Return a length as a number of millimetres; a dash where it is not known."""
    return _number(None if metres is None else metres * 1e3)


def _number(value: float | None) -> str:
    return DASH if value is None or not math.isfinite(value) else f"{value:.2f}"
