"""What the session took from the detector with one item, as a value that goes to the journal and comes back bit for bit.

Floats are written by their shortest exact decimals; NaN is null, and what is infinite is a word.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from typing import Any, cast

import numpy as np

from skincal.contacts.detector import Doubt
from skincal.contacts.judge import Poke, StillMean
from skincal.contacts.outcome import Contact, Outcome, Reason, Rejection
from skincal.contacts.tare import Tare

_INTEGERS = ("channels",)
"""Arrays of whole numbers; all others are float."""


@dataclass(frozen=True, slots=True)
class Taken:
    """Outcomes, each with what it may be judged by again, and the dead channels where they changed."""

    outcomes: Sequence[tuple[Outcome, Doubt | None]]
    dead: Mapping[int, str] | None = None
    """Every channel found to be dead, with the reason; None: as before."""


def taken_to_json(taken: Taken) -> dict[str, Any]:
    """Return it as a JSON object."""
    document: dict[str, Any] = {"outcomes": [_outcome_to_json(outcome, doubt) for outcome, doubt in taken.outcomes]}
    if taken.dead is not None:
        document["dead"] = {str(channel): why for channel, why in taken.dead.items()}
    return document


def taken_from_json(document: Mapping[str, Any]) -> Taken:
    """Return what `taken_to_json` was given.

    Raises
    ------
    KeyError, TypeError, ValueError
        It is not one that skincal wrote.
    """
    dead = document.get("dead")
    return Taken(
        outcomes=[_outcome_from_json(entry) for entry in document["outcomes"]],
        dead=None if dead is None else {int(channel): str(why) for channel, why in dead.items()},
    )


def _outcome_to_json(outcome: Outcome, doubt: Doubt | None) -> dict[str, Any]:
    document = {"is": "contact" if isinstance(outcome, Contact) else "rejection", **_to_json(outcome)}
    if doubt is not None:
        document["doubt"] = {"poke": _to_json(doubt.poke), "after": _to_json(doubt.after)}
    return document


def _outcome_from_json(document: Mapping[str, Any]) -> tuple[Outcome, Doubt | None]:
    values = _values(document)
    doubt = values.pop("doubt", None)
    if values.pop("is") == "contact":
        return Contact(**values), _doubt(doubt)
    values["reason"] = Reason[values["reason"]]
    return Rejection(**values), _doubt(doubt)


def _doubt(document: Mapping[str, Any] | None) -> Doubt | None:
    if document is None:
        return None
    values = _values(document["poke"])
    still = values["still"]
    before = _tare(document["poke"]["before"])
    assert before is not None
    values |= {"before": before, "still": None if still is None else StillMean(**_values(still))}
    return Doubt(Poke(**values), _tare(document["after"]))


def _tare(document: Mapping[str, Any] | None) -> Tare | None:
    # The skin's baseline has done its work in the poke's responses; hundreds of numbers stay out of the journal.
    return None if document is None else Tare(**_values(document), skin=np.empty(0))


def _to_json(value: Any) -> Any:
    """Return a number, array, enum or frozen dataclass as JSON."""
    if value is None or isinstance(value, str | bool | int):
        return value
    if isinstance(value, float):
        return float(value) if math.isfinite(value) else None if math.isnan(value) else str(float(value))
    if isinstance(value, np.ndarray):
        return [_to_json(row) for row in cast("list[Any]", value.tolist())]
    if isinstance(value, list):
        return [_to_json(item) for item in cast("list[Any]", value)]
    if isinstance(value, Reason):
        return value.name
    left_out = ("skin",) if isinstance(value, Tare) else ()
    return {item.name: _to_json(getattr(value, item.name)) for item in fields(value) if item.name not in left_out}


def _values(document: Mapping[str, Any]) -> dict[str, Any]:
    """Return the fields of a dataclass: lists as arrays, null as NaN where a float belongs."""
    return {key: _value(key, value) for key, value in document.items()}


def _value(key: str, value: Any) -> Any:
    if isinstance(value, list):
        # As a float, null becomes NaN and "inf" infinity.
        return np.array(value, dtype=np.int64 if key in _INTEGERS else np.float64)
    if value is None:
        return None if key in ("still", "link_from_sensor", "after") else math.nan
    if value in ("inf", "-inf"):
        return float(value)
    return value
