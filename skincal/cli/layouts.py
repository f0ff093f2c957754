"""What `solve` says of the layout, and the corrected one that it writes."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from skincal.model.errors import InputError
from skincal.modules.health import LayoutMend, judged_modules, mend_modules
from skincal.sentences import change_words, left_sentences, misfit_sentence
from skincal.session.session import Session
from skincal.taxels.result import Method


def layout_result(session: Session, used: Path | None, out: Path | None) -> tuple[dict[str, Any], list[str]]:
    """Return what is to be said of the layout, for JSON and in lines; write the corrected one where that is wanted.

    Modules are judged by the estimates of the surface method where there is one, else by those of free.

    Parameters
    ----------
    used : the layout's file where it is not the session's own
    out : file for the corrected layout; None writes none

    Raises
    ------
    InputError
        There is no layout to correct, or the file cannot be written.
    """
    lines = [] if used is None else [f"solved with the layout {used} in place of the session's"]
    result: dict[str, Any] = {"misfits": [], "layout": {"used": _name(used), "changes": [], "left": [], "written": None}}
    if session.boards is None:
        if out is not None:
            raise InputError(
                "--layout-out corrects a layout, and the scene has none; expected modules in its [skin], or --layout."
            )
        return result, lines
    told = session.snapshot().estimates
    estimates = {one.channel: one for one in told.get(Method.SURFACE) or told.get(Method.FREE, ())}
    mend = mend_modules(session.boards, estimates)
    written = out if mend.changes else None
    if written is not None:
        from skincal.files.layout_file import write_layout

        write_layout(session.boards.layout, mend, written)
    misfits = [misfit_sentence(misfit) for misfit in mend.misfits]
    changes = [{"module": change.module, **change.keys} for change in mend.changes]
    layout = {"used": _name(used), "changes": changes, "left": left_sentences(mend), "written": _name(written)}
    lines += [*misfits, *_lines(mend, out, judged_modules(session.boards, estimates))]
    return {"misfits": misfits, "layout": layout}, lines


def _lines(mend: LayoutMend, out: Path | None, judged: int) -> list[str]:
    """Return what is said of the correction, without the misfits themselves."""
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


def _name(path: Path | None) -> str | None:
    return None if path is None else str(path)
