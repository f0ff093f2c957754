"""What the session took from the detector with one item, as a value that goes to the journal and comes back bit for bit.

Floats are written by their shortest exact decimals; NaN is null, and what is infinite is a word.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from functools import lru_cache
from typing import Any, cast

import numpy as np

from skincal.contacts.detector import Doubt
from skincal.contacts.gates import FinishedPress, StillMean
from skincal.contacts.outcome import Contact, Outcome, Reason, Rejection
from skincal.contacts.tare import Tare
from skincal.geometry.arrays import FloatArray

_INTEGERS = ("channels",)
"""Arrays of whole numbers; all others are float."""
_MISSING = ("still", "link_from_sensor", "after", "force", "moment")
"""What may be missing; elsewhere null is a float that is none."""


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
    doubt = _doubt(document.get("doubt"))
    if document["is"] == "contact":
        return _contact(document), doubt
    values = _values({key: value for key, value in document.items() if key not in ("is", "doubt")})
    values["reason"] = Reason[values["reason"]]
    return Rejection(**values), doubt


def _contact(document: Mapping[str, Any]) -> Contact:
    # Written out, and not as `_values` does it: a session has ten thousand of these, and opening it waits for them.
    return Contact(
        poke=document["poke"],
        start_s=_number(document["start_s"]),
        end_s=_number(document["end_s"]),
        force=np.array(document["force"], dtype=np.float64),
        moment=np.array(document["moment"], dtype=np.float64),
        channels=np.array(document["channels"], dtype=np.int64),
        responses=np.array(document["responses"], dtype=np.float64),
        link_from_sensor=_pose(np.array(document["link_from_sensor"], dtype=np.float64).tobytes()),
        pose=document["pose"],
        tare_change=_number(document["tare_change"]),
        final=document["final"],
    )


@lru_cache(maxsize=64)
def _pose(raw: bytes) -> FloatArray:
    """Return a pose, (4, 4), from its bytes: one array for all pokes in it, and not to be written to."""
    return np.frombuffer(raw).reshape(4, 4)


def _number(value: float | str | None) -> float:
    return math.nan if value is None else float(value)


def _doubt(document: Mapping[str, Any] | None) -> Doubt | None:
    if document is None:
        return None
    values = _values(document["poke"])
    still = values["still"]
    before = _tare(document["poke"]["before"])
    assert before is not None
    values |= {"before": before, "still": None if still is None else StillMean(**_values(still))}
    return Doubt(FinishedPress(**values), _tare(document["after"]))


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
        return None if key in _MISSING else math.nan
    if value in ("inf", "-inf"):
        return float(value)
    return value
