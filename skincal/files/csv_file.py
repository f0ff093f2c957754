"""A calibration as CSV: one row a channel and method."""

from __future__ import annotations

import csv
import io
import math

from skincal.estimate.result import Estimate
from skincal.files.calibration import Calibration
from skincal.readings import FloatArray

COLUMNS = ("channel", "module", "method", "state", "contacts", "x_m", "y_m", "z_m", "nx", "ny", "nz", "sd_mm")


def csv_text(calibration: Calibration) -> str:
    """Return the CSV text of every method; what is not known is left empty.

    Positions are metres in the link frame, `sd_mm` is the predicted sd along the weakest direction, millimetres. Numbers
    have every digit that a double needs.
    """
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow(COLUMNS)
    for estimates in calibration.estimates.values():
        for estimate in estimates:
            writer.writerow(_row(calibration, estimate))
    return out.getvalue()


def _row(calibration: Calibration, estimate: Estimate) -> list[str]:
    module = calibration.module_id(estimate.channel)
    sd = None if estimate.sd is None or estimate.position is None else estimate.sd * 1e3
    return [
        str(estimate.channel),
        "" if module is None else str(module),
        estimate.method.value,
        estimate.state.value,
        str(estimate.contacts),
        *_vector(estimate.position),
        *_vector(estimate.normal if estimate.position is not None else None),
        _number(sd),
    ]


def _vector(vector: FloatArray | None) -> list[str]:
    if vector is None:
        return ["", "", ""]
    return [_number(value) for value in vector.tolist()]


def _number(value: float | None) -> str:
    return "" if value is None or not math.isfinite(value) else repr(float(value))
