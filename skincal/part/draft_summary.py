"""Summary of a draft: complete and missing things, and the cost of each missing one."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

from skincal.mesh.findings import box_words
from skincal.model.errors import plural
from skincal.model.skin import SkinKind
from skincal.part.draft_preview import PartPreview
from skincal.part.tool_draft import Rig, tool_costs
from skincal.words.layout_words import SHEET_WITHOUT_MESH, SKIN_KIND_WORDS, layout_size, unsaid_kind_finding

LANDMARKS_OF_POSE = 3
"""Landmarks that show a pose, if they are not on a line."""
_RIG_WORDS = {
    Rig.ON_TOOL: "the force/torque sensor is on the tool, whose poses are streamed",
    Rig.NONE: "no force/torque sensor: the poses of a tool with a tip are streamed",
}


class State(Enum):
    """State of one line of the summary."""

    COMPLETE = "complete"
    OPTIONAL = "optional"
    """Missing, and the part can be calibrated without it, at a cost."""
    NEEDED = "needed"
    """Missing or wrong, and nothing can start."""


@dataclass(frozen=True, slots=True)
class SummaryLine:
    """One line of the builder's summary: what is complete or missing."""

    step: str
    """Name of the step that changes it."""
    state: State
    text: str


def summarize(preview: PartPreview) -> tuple[SummaryLine, ...]:
    """Summarize a new part, line by line: complete, or missing with the consequence."""
    return (_part(preview), *_sensor(preview), *_joints(preview), *_skin(preview), *_place(preview), *_landmarks(preview))


def can_start(preview: PartPreview) -> bool:
    """Whether a session can start with this draft."""
    return all(line.state is not State.NEEDED for line in summarize(preview))


def why_not_simulated(preview: PartPreview) -> str:
    """Give the reason why no simulated hand can poke this part, with the remedy; empty if one can."""
    missing = next((line for line in summarize(preview) if line.state is State.NEEDED), None)
    if missing is not None:
        return missing.text
    if preview.layout is None:
        return "A simulated hand needs a layout: choose one in the step Skin."
    if preview.laid is None or (preview.proposed_anchor is not None and preview.draft.anchor is None):
        return "A simulated hand needs the place of the layout: click it in the step Place."
    return ""


def _part(preview: PartPreview) -> SummaryLine:
    problem = preview.problems.get("part")
    if problem is not None:
        return SummaryLine("part", State.NEEDED, problem)
    if preview.draft.mesh is None and preview.draft.urdf is None and preview.draft.source is None:
        return SummaryLine("part", State.NEEDED, "Choose the mesh of the part, or the URDF of its robot.")
    if preview.size_mm is None:
        cost = "no mesh: the surface method is not available, and taxels need pokes from several directions"
        return SummaryLine("part", State.OPTIONAL if preview.draft.source is not None else State.NEEDED, cost)
    size = f"mesh of {box_words(preview.size_mm)}, frame {preview.draft.link}"
    if preview.draft.is_unit_guessed:
        return SummaryLine("part", State.OPTIONAL, f"{size}; its unit is guessed from its size: check it in the list Unit")
    return SummaryLine("part", State.COMPLETE, size)


def _sensor(preview: PartPreview) -> tuple[SummaryLine, ...]:
    problem = preview.problems.get("sensor")
    if problem is not None:
        return (SummaryLine("sensor", State.NEEDED, problem),)
    draft = preview.draft
    if draft.rig is not Rig.BELOW:
        costs = (SummaryLine("sensor", State.OPTIONAL, each) for each in tool_costs(draft.rig, draft.tool))
        return (SummaryLine("sensor", State.COMPLETE, _RIG_WORDS[draft.rig]), *costs)
    pose = preview.sensor_pose
    assert pose is not None
    where = ", ".join(str(round(value * 1e3)) for value in pose[:3, 3].tolist())
    text = f"sensor {draft.sensor} at {where} mm" if draft.sensor else f"sensor at {where} mm"
    if draft.urdf is not None and draft.sign is None and preview.sign is None:
        text += "; the URDF does not say whether it reports the force or its reaction: the first pokes will show it"
    found = preview.findings.get("sensor", ())
    return (SummaryLine("sensor", State.COMPLETE, text), *(SummaryLine("sensor", State.OPTIONAL, each) for each in found))


def _joints(preview: PartPreview) -> tuple[SummaryLine, ...]:
    if preview.draft.rig is not Rig.BELOW:
        return ()
    problem = preview.problems.get("joints")
    if problem is not None:
        return (SummaryLine("joints", State.NEEDED, problem),)
    if not preview.joints:
        return ()
    names = ", ".join(joint.name for joint in preview.joints)
    return (SummaryLine("joints", State.COMPLETE, f"{plural(len(preview.joints), 'joint')} between sensor and part: {names}"),)


def _skin(preview: PartPreview) -> tuple[SummaryLine, ...]:
    problem = preview.problems.get("skin")
    if problem is not None:
        return (SummaryLine("skin", State.NEEDED, problem),)
    draft, layout = preview.draft, preview.layout
    rises = "rise" if draft.polarity == "up" else "fall"
    channels = draft.channels if draft.channels is not None or layout is None else layout.width
    frame = SummaryLine("skin", State.COMPLETE, f"{plural(channels or 0, 'value')} a frame, which {rises} under pressure")
    if layout is None:
        cost = "no layout: no modules method, the guide searches for the taxels, and the skin cannot be simulated"
        return frame, SummaryLine("skin", State.OPTIONAL, cost)
    parts = f"layout of {layout_size(layout)}: "
    parts += SKIN_KIND_WORDS[layout.kind]
    if unsaid_kind_finding(layout):
        return frame, SummaryLine("skin", State.OPTIONAL, f"{parts}, since the layout does not say what the skin is")
    if layout.kind is SkinKind.SHEET and preview.surface is None:
        return frame, SummaryLine("skin", State.OPTIONAL, f"{parts}; {SHEET_WITHOUT_MESH}")
    return frame, SummaryLine("skin", State.COMPLETE, parts)


def _place(preview: PartPreview) -> tuple[SummaryLine, ...]:
    if preview.layout is None:
        return ()
    problem = preview.problems.get("place")
    if problem is not None and preview.draft.anchor is None:
        cost = "the layout is not placed: the guide searches for the taxels, and the skin cannot be simulated"
        return (SummaryLine("place", State.OPTIONAL, cost),)
    if problem is not None:
        return (SummaryLine("place", State.NEEDED, problem),)
    findings = preview.findings.get("place", ())
    if findings:
        return tuple(SummaryLine("place", State.OPTIONAL, finding) for finding in findings)
    if preview.surface is None:
        return (SummaryLine("place", State.COMPLETE, "the layout lies in a plane; without a mesh nothing checks it"),)
    return (SummaryLine("place", State.COMPLETE, "every taxel is on the part"),)


def _landmarks(preview: PartPreview) -> tuple[SummaryLine, ...]:
    found = (SummaryLine("check", State.OPTIONAL, each) for each in preview.findings.get("check", ()))
    draft = preview.draft
    has_pose = draft.tool.base_from_link is not None
    return (_landmark_count(len(draft.landmarks), draft.rig, has_part_pose=has_pose), *found)


def _landmark_count(count: int, rig: Rig, *, has_part_pose: bool) -> SummaryLine:
    if rig is not Rig.BELOW and not has_part_pose and count < LANDMARKS_OF_POSE:
        cost = f"{plural(count, 'landmark')}: with {LANDMARKS_OF_POSE} or more a few touches show the part's pose; fewer "
        return SummaryLine("check", State.OPTIONAL, cost + "leave it to the pokes on the skin")
    if count == 0:
        return SummaryLine("check", State.OPTIONAL, "no landmarks: a common shift of all taxels would go unnoticed")
    if count < 3:
        cost = f"{plural(count, 'landmark')}: three or more also show a turned or wrong sensor frame"
        return SummaryLine("check", State.OPTIONAL, cost)
    return SummaryLine("check", State.COMPLETE, plural(count, "landmark"))
