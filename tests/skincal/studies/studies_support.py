"""Each study so small that several tests can share it, in this process."""

from __future__ import annotations

from dataclasses import replace
from functools import cache, cached_property
from typing import Any

import pytest

from skincal.mesh.surface import Surface
from skincal.simulation.example_parts import SHAPE_OF_PART, ExamplePart
from skincal.simulation.poking_strategies import Conditions
from skincal.studies import load_study
from skincal.studies.axes_study import AxesSizes
from skincal.studies.guidance_study import GuidanceSizes
from skincal.studies.paper import PaperSizes
from skincal.studies.robot import RobotSizes
from skincal.studies.runtime import PartPlan, RuntimeSizes
from skincal.studies.stability_cases import CaseSizes
from skincal.studies.tip_study import TipSizes
from skincal.studies.tool_study import BASE_ALONE, POSE_FOUND, ToolCase, ToolSizes
from skincal.studies.unmodelled import UnmodelledSizes

FOREARM = "icub-forearm"
COARSE_TRIANGLES = 2_000
STABILITY_CASES = (
    "axes within 1e-3 rad", "axes within 1e-9 rad", "one axis, many forces", "one axis, read many times",
    "surface, axes within 1e-9 rad", "module, two pokes", "module on a sheet, 7 arm poses", "module on a sheet, shared errors",
)  # fmt: skip
SIZES: dict[str, Any] = {
    "stability": CaseSizes(contacts=6, grid=4, many=300, draws=4, only=frozenset(STABILITY_CASES)),
    "axes": AxesSizes(seeds=1, mistake_seeds=1, skins=("noise",), leans_deg=(15.0,), taxel_pokes=(20,), module_pokes=(8,)),
    "guidance": GuidanceSizes(
        seeds=1, other_seeds=1, case_seeds=1, guided_limit=30, free_limit=24, surface_limit=90, modules_limit=30,
        modules_seeds=1, long=40, cases={"drift 0.25 N": Conditions(drift=0.25)},
    ),
    "paper": PaperSizes(seeds=2, share=0.1, safety=1, good=1, counts=(42, 252), courses=2, steps=(28, 84)),
    "runtime": RuntimeSizes(
        small=PartPlan(FOREARM, 1, 1, (300,), (1,), budget_s=0.02),
        large=PartPlan(FOREARM, 1, 1, (1_000,), (), (24,), budget_s=0.02),
        per_taxel=2,
        live_pokes=3,
        live_per_taxel=(2,),
        session_pokes=((20,), (20, 100)),
    ),
    "robot": RobotSizes(("arm",), {"all": 1}, max_pokes=2, displaced_mm=(), are_whole=False),
    "tip": TipSizes(
        seeds=1, pokes_per_taxel=1, counts=(42, 84), cases=(("good", None), ("good", 1.0), ("corrected", 1.0))
    ),
    "tool": ToolSizes(
        seeds=1,
        counts=(42, 168),
        cases=(
            ToolCase("ideal", POSE_FOUND, 6, has_mesh=True), ToolCase("wrist", POSE_FOUND, 6, has_mesh=True),
            ToolCase("good_wrist", POSE_FOUND, 6, has_mesh=True), ToolCase("good_wrist", BASE_ALONE, 0, has_mesh=False),
        ),
    ),
    "unmodelled": UnmodelledSizes(seeds=1, cases=("nothing", "gaussian"), sheet_seeds=0),
}  # fmt: skip


class CoarsePart(ExamplePart):
    """An example part whose own mesh has few triangles: a general solver takes a programme for each."""

    @cached_property
    def surface(self) -> Surface:
        return SHAPE_OF_PART[self.name].mesh(COARSE_TRIANGLES)


@cache
def small(name: str) -> tuple[dict[str, Any], list[str]]:
    """Return a study's result and what it said on the way."""
    said: list[str] = []
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("skincal.studies.runtime.ExamplePart", CoarsePart)
        return replace(load_study(name), in_processes=False).run(True, said.append, SIZES[name]), said
