"""A runtime study so small that several tests can share it."""

from __future__ import annotations

from functools import lru_cache
from typing import Any

from skincal.studies import runtime
from skincal.studies.runtime import PartPlan, RuntimeSizes

FOREARM = "icub-forearm"
TINY = RuntimeSizes(
    small=PartPlan(FOREARM, 2, 1, (300,), (1,), budget_s=0.02),
    large=PartPlan(FOREARM, 1, 1, (1_000,), (), (24,), budget_s=0.02),
    per_taxel=2,
    live_pokes=3,
    live_per_taxel=(2,),
)


@lru_cache
def tiny() -> tuple[dict[str, Any], list[str]]:
    """Return the study's result and what it said on the way."""
    said: list[str] = []
    return runtime.run(True, said.append, TINY), said
