"""Positions of taxels by name: a session with a method, its plan or its truth, or a file."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import replace
from pathlib import Path

from skincal.files.reference import TRUTH_NAME, TaxelPositions, read_place_sets, read_places, require_same_part
from skincal.geometry import FloatArray
from skincal.methods import leading_method
from skincal.model.errors import InputError
from skincal.model.skin import Layout
from skincal.model.tool_rig import BASE_LINK
from skincal.part.part import lay_part
from skincal.part.robot_places import robot_places
from skincal.session.pipeline import Pipeline
from skincal.session.replay import load
from skincal.session.session import Session
from skincal.taxels.result import Method

PLAN, TRUTH, ROBOT = "plan", "truth", "robot"
PLACE_WORDS = (*(method.value for method in Method), PLAN, TRUTH, ROBOT)
"""Words that may follow the colon."""


def find_places(named: str) -> TaxelPositions:
    """Find the positions of a name.

    Parameters
    ----------
    named : folder of a session or a file (`read_places`); after a colon a method, or for a session `plan` (the laid layout),
        `truth` (of a simulated rig) or `robot` (the URDF's skin frames). Without a colon the leading method

    Raises
    ------
    InputError
        There is no such session or file, or it lacks the named positions.
    """
    head, _, last = named.rpartition(":")
    path, which = (Path(head), last) if head and not Path(named).exists() and Path(head).exists() else (Path(named), "")
    if which and which not in PLACE_WORDS:
        raise InputError(
            f"{named}: {which!r} names no places of {head}; expected one of {', '.join(PLACE_WORDS)} after the colon."
        )
    if path.is_dir():
        return session_places(path, which)
    if not path.exists():
        raise InputError(f"{named}: there is no such session or file; check the path.")
    if which in (PLAN, TRUTH, ROBOT):
        raise InputError(f"{named}: only the folder of a session has a {which}; name a folder, or a file without {which!r}.")
    return read_places(path, Method(which) if which else None)


def session_places(folder: Path, which: str = "") -> TaxelPositions:
    """Find positions of a recorded session; `which` is one of `PLACE_WORDS`, empty for the leading method.

    `InputError` if it is no session or lacks them.
    """
    name = folder.resolve().name
    if which == TRUTH:
        truth = read_places(folder / TRUTH_NAME)
        return replace(truth, name=f"{name}, truth")
    pipeline = load(folder)
    if which == PLAN:
        return _plan_of(pipeline, name)
    if which == ROBOT:
        return _robot_of(pipeline, name)
    sets = _sets_of(pipeline, folder)
    chosen = next((each for each in sets if not which or each.method is Method(which)), None)
    if chosen is None:
        known = " or ".join(f"{folder}:{each.method.value}" for each in sets if each.method)
        raise InputError(f"{folder}: has no places by the {which} method; expected {known}.")
    return chosen


def places_for(path: Path, link: str, channels: Collection[int]) -> tuple[TaxelPositions, ...]:
    """Read all positions of a part's taxels from a file, or by each method from a session's folder, the leading one first.

    `InputError` as for `find_places`, and for another link than `link` or without any of `channels`.
    """
    read = _sets_of(load(path), path) if path.is_dir() else read_place_sets(path)
    # A method without estimates is left out; a file without any position is refused below.
    sets = tuple(found for found in read if found.places) or read[:1]
    for found in sets:
        require_same_part(found, path, link, channels)
    return sets


def _sets_of(pipeline: Pipeline, folder: Path) -> tuple[TaxelPositions, ...]:
    """Collect the positions of each method of a session; `InputError` if there are none."""
    estimates, scene, name = pipeline.snapshot().estimates, pipeline.scene, folder.resolve().name
    leads, modules = leading_method(estimates), _modules_of(scene.skin.layout)
    if leads is None:
        raise InputError(f"{folder}: no taxel is known in this session yet; poke some more, or name its plan or its truth.")
    known = {
        method: {estimate.channel: estimate.position for estimate in found if estimate.position is not None}
        for method, found in estimates.items()
    }
    order = sorted(filter(known.__getitem__, known), key=lambda method: method is not leads)
    link = scene.link if pipeline.snapshot().is_placed else BASE_LINK
    return tuple(
        TaxelPositions(f"{name}, {each.value} method", link, known[each], modules, each, axes=_axes_of(pipeline.session, each))
        for each in order
    )


def _axes_of(session: Session, method: Method) -> Mapping[int, FloatArray]:
    """Gather the axes of taxels that measure three; empty for others."""
    found = session.axis_results()
    if found is None:
        return {}
    from skincal.axes.turn_differences import axes_of_turns  # other skins do without

    return axes_of_turns(found.usable_turns(method))


def _plan_of(pipeline: Pipeline, name: str) -> TaxelPositions:
    scene = pipeline.scene
    plan = lay_part(scene, pipeline.session.surface, ()).plan
    if plan is None:
        raise InputError(f"{name}: its scene does not say where the layout lies on the part, so there is no plan.")
    return TaxelPositions(f"{name}, plan", scene.link, plan.places, _modules_of(scene.skin.layout))


def _robot_of(pipeline: Pipeline, name: str) -> TaxelPositions:
    found = robot_places(pipeline.scene)
    if found is None:
        raise InputError(
            f"{name}: its scene has no URDF with skin frames fixed to {pipeline.scene.link}; expected links such as "
            f"{pipeline.scene.link}_skin_3."
        )
    return replace(found, name=f"{name}, {found.name}")


def _modules_of(layout: Layout | None) -> dict[int, int]:
    if layout is None:
        return {}
    return {int(channel): module.id for module in layout.modules for channel in module.channels}
