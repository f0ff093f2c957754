"""How many pokes the guide needs to a mean error of 5 mm by the free method: `python3 -m pytest tests/long`."""

from statistics import median

import pytest

from skincal.simulation.example_parts import ExamplePart
from skincal.simulation.poking_strategies import Conditions, run_course
from skincal.studies.guidance_study import POKES_TO_5_MM_MAX, QUICK_SIZES
from skincal.taxels.result import Method


@pytest.mark.timeout(300)
def test_the_guide_needs_at_most_87_pokes_to_5_mm():
    seeds = range(1, QUICK_SIZES.seeds + 1)
    courses = [run_course(ExamplePart(), "guided", Method.FREE, Conditions(), seed, 110) for seed in seeds]
    assert POKES_TO_5_MM_MAX == 87.0
    assert median(course.pokes_to(0.005) for course in courses) <= POKES_TO_5_MM_MAX
