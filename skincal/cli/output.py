"""Summaries of a session that several commands print, as text and as JSON."""

from __future__ import annotations

import json
import math
import os
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from typing import Any

from skincal.cli.terminal import say
from skincal.contacts.outcome import Reason
from skincal.files.reference import error_summary
from skincal.following.results import SessionResults
from skincal.geometry import FloatArray
from skincal.guide.verdict import Verdict
from skincal.journal.documents import LinkTotals
from skincal.model.readings import LinkHealth, LinkState
from skincal.model.scene import Scene
from skincal.model.skin import Layout
from skincal.modules.health import spacing_ratio
from skincal.session.snapshot import Snapshot
from skincal.taxels.result import Estimate, Method, State
from skincal.taxels.shared_errors import PredictedError, predicted_error
from skincal.words.link_words import beside_words, outage_words
from skincal.words.poke_words import words_of_reason
from skincal.words.taxel_words import predicted_words, unchecked_sentence
from skincal.words.verdict_words import verdict_sentence


def print_result(result: Mapping[str, Any], text: Sequence[str], as_json: bool) -> None:
    """Print a command's result on stdout, as JSON or as lines of text."""
    for line in [json.dumps(result, allow_nan=False, default=os.fspath)] if as_json else text:
        say(line)


def verdict_words(verdict: Verdict) -> str:
    """Summarize the verdict on a session, without a full stop."""
    return verdict_sentence(verdict).rstrip(".")


def unchecked_lines(results: SessionResults, unchecked: float | None) -> list[str]:
    """Format the possible shift of the taxels (m rms) by sensor and arm errors, which the predicted error leaves out."""
    return [] if unchecked is None else [_unchecked(results, unchecked)]


def _unchecked(results: SessionResults, unchecked: float) -> str:
    return unchecked_sentence(unchecked, len(results.session.landmark_pokes), has_arm=results.session.scene.arm is not None)


def poke_counts(snapshot: Snapshot) -> dict[str, Any]:
    """Count pokes by outcome."""
    counts = snapshot.poke_counts
    return {
        "pokes": counts.pokes,
        "accepted": counts.accepted,
        "excluded": counts.excluded,
        "at_landmarks": counts.at_landmarks + counts.on_both,
        "rejected": dict(sorted((reason.value, count) for reason, count in counts.rejected.items())),
    }


PREDICTED_KEYS = {"mean": "mean", "worst": "worst", "whole": "whole_skin", "among": "among_taxels"}
"""Numbers of `PredictedError`: name to key of the JSON."""


def _finite_mm(length: float) -> float | None:
    return 1e3 * length if math.isfinite(length) else None


def method_summaries(
    estimates: Mapping[Method, tuple[Estimate, ...]],
    reference: Mapping[int, FloatArray] | None,
    layout: Layout | None,
    part_size: float,
    kind: str = "",
) -> dict[str, Any]:
    """Summarise every method, by its name with `kind` after it."""
    return {method.value + kind: method_summary(found, reference, layout, part_size) for method, found in estimates.items()}


def uncompared_findings(snapshot: Snapshot, reference: Mapping[int, FloatArray] | None) -> list[str]:
    """Say why a given reference is not compared: its positions are in the part's frame, those found are in the base."""
    if reference is None or snapshot.is_placed:
        return []
    return ["The reference is not compared: the positions are in the base until the part's pose is known."]


def method_summary(
    estimates: tuple[Estimate, ...], reference: Mapping[int, FloatArray] | None, layout: Layout | None, part_size: float
) -> dict[str, Any]:
    """Summarise one method: taxels by state, predicted error, and the error where a reference is known; millimetres.

    `spacing_ratio` is how far neighbours lie apart over how far the layout plans it; None without a layout.
    """
    # All states are written, also those of no taxel, so that a program finds each key.
    states = Counter(e.state.value for e in estimates)
    predicted = predicted_error(estimates, part_size)
    summary: dict[str, Any] = {
        "states": {state.value: states.get(state.value, 0) for state in State},
        "predicted_error_mm": None
        if predicted is None
        else {key: _finite_mm(getattr(predicted, name)) for name, key in PREDICTED_KEYS.items()},
        "taxels_not_known_yet": 0 if predicted is None else predicted.unknown,
        "spacing_ratio": None if layout is None else spacing_ratio(layout, estimates),
    }
    if reference is not None:
        error = error_summary(estimates, reference)
        summary["error_mm"] = None if error is None else {
            "taxels": error.taxels, "mean": error.mean * 1e3, "sd": error.sd * 1e3,
            "p95": error.p95 * 1e3, "max": error.max * 1e3, "worst_channel": error.worst_channel,
        }  # fmt: skip
    return summary


def loss_counts(links: Sequence[LinkHealth | LinkTotals], unpaired: int) -> dict[str, Any]:
    """Count good readings and losses by link and reason."""
    counts = {
        link.link: {
            "format": link.format,
            "readings": link.readings,
            "lost": {loss.value: count for loss, count in link.losses.items() if count},
            "beside": {name: asdict(found) for name, found in link.beside.items()},
            "outages": asdict(link.outages),
        }
        for link in links
    }
    return {"links": counts, "frames_without_wrench": unpaired}


def poke_lines(counts: Mapping[str, Any], scene: Scene) -> list[str]:
    """Return the text for `poke_counts`."""
    arm_pose = "" if scene.tool is None else scene.tool.arm_pose
    rejected = ", ".join(f"{words_of_reason(Reason(key), arm_pose)}: {count}" for key, count in counts["rejected"].items())
    pokes = "1 poke" if counts["pokes"] == 1 else f"{counts['pokes']} pokes"
    line = f"{pokes}: {counts['accepted']} accepted, {sum(counts['rejected'].values())} rejected"
    line += f" ({rejected})" if rejected else ""
    beside = {"excluded": counts["excluded"], "at landmarks": counts["at_landmarks"]}
    return [line + "".join(f", {count} {words}" for words, count in beside.items() if count)]


LEADS_WORDS = "; leads, as the one that predicts the smallest error"


def method_lines(methods: Mapping[str, Mapping[str, Any]], leads: str | None) -> list[str]:
    """Format each summary of `method_summaries` as a line of text, the leading method first."""
    order = sorted(methods, key=lambda name: name != leads)
    return [method_line(name, methods[name]) + (LEADS_WORDS if name == leads else "") for name in order]


def method_line(name: str, summary: Mapping[str, Any]) -> str:
    """Format a `method_summary` as a line of text."""
    predicted, ratio, error = summary["predicted_error_mm"], summary["spacing_ratio"], summary.get("error_mm")
    states = ", ".join(f"{count} {state}" for state, count in summary["states"].items() if count)
    line = f"{name:8s} {states or 'no taxel seen'}"
    if predicted is not None:
        lengths = ((name, predicted[key]) for name, key in PREDICTED_KEYS.items())
        error_m = PredictedError(
            **{name: math.nan if length is None else length * 1e-3 for name, length in lengths},
            unknown=summary["taxels_not_known_yet"],
        )
        line += f"; expected error {predicted_words(error_m)}"
    if ratio is not None:
        line += f"; neighbours {ratio:.2f} of the layout's spacing apart"
    if error is not None:
        line += f"; error against the reference {error['mean']:.2f} mm mean (sd {error['sd']:.2f}, max {error['max']:.2f})"
    return line


def loss_lines(links: Sequence[LinkHealth | LinkTotals]) -> list[str]:
    """Format good readings and losses of each link as a line of text."""
    lines: list[str] = []
    for link in links:
        lost = ", ".join(f"{count} {loss.value}" for loss, count in link.losses.items() if count)
        of = f" of {link.format}" if link.format else ""
        counted = f"{link.link}: {link.readings} readings{of}; lost: {lost or 'none'}"
        lines.append("; ".join(filter(None, (counted, outage_words(link.outages), beside_words(link.beside)))))
    return lines


def link_notes(links: Sequence[LinkHealth]) -> list[str]:
    """List the last message of each open link's device."""
    notes = [(link.link, link.text) for link in links if link.state is LinkState.OPEN]
    notes += [(link.link, link.warning) for link in links]
    return [f"{name}: {text}" for name, text in notes if text]


def turn_result(results: SessionResults) -> tuple[dict[str, Any], list[str]]:
    """Summarize the turns of taxels of three axes, as JSON and in lines; both empty for other skins."""
    found = results.session.axis_results()
    if found is None:
        return {}, []
    from skincal.words.axis_words import shared_sentence, turn_summary

    method = results.choose_method(None)
    findings, frames = found.findings(method), found.frames(method)
    # Readings of other taxels say nothing about turns.
    own_sentence = "" if findings.is_value_order_wrong else shared_sentence(findings)
    words = [turn_summary([*frames.values()]), *filter(None, [own_sentence])]
    states = Counter(frame.state.value for frame in frames.values())
    summary: dict[str, Any] = {
        "method": method.value,
        "states": dict(states),
        "log_odds_shared": findings.log_odds_shared,
        "taxels": {
            str(channel): {
                "z_sd_deg": math.degrees(frame.normal_sd), "in_plane_sd_deg": math.degrees(frame.in_plane_sd),
            }
            for channel, frame in frames.items()
            if frame.is_known
        },
        "words": words,
    }  # fmt: skip
    return summary, words
