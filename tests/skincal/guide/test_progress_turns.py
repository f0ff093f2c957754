"""Whose turn it is: rounds of taxels, rounds of modules, and where in a module."""

import numpy as np
import pytest

from skincal.guide.progress import Turns

LINE = np.arange(6)[:, None] * [0.005, 0.0, 0.0]


def asked_for(modules, turns, answers=None, places=LINE, rows=None, seconds=None):
    """Poke `turns` times what is next; a taxel of `answers` is answered by that one, None by none."""
    count = len(modules)
    asked, own = np.zeros(count, dtype=np.int64), np.zeros(count, dtype=np.int64)
    rows, found = np.arange(count) if rows is None else np.array(rows), []
    for _ in range(turns):
        row = Turns(places, np.array(modules), asked, own).module_taxel(
            rows, np.ones(len(rows)) if seconds is None else seconds
        )
        found.append(row)
        asked[row] += 1
        hit = (answers or {}).get(row, row)
        if hit is not None:
            own[hit] += 1
    return found


def test_modules_take_turns_and_each_poke_lies_far_from_those_before():
    found = asked_for([0, 0, 0, 1, 1, 1], 6)
    assert found == [0, 3, 2, 5, 1, 4]


@pytest.mark.parametrize("rows", [[0, 1], [0, 2, 5], [0, 1, 2, 3, 4, 5]])
def test_taxels_that_were_all_poked_take_turns(rows):
    found = asked_for([0] * 6, 4 * len(rows), rows=rows)
    assert np.bincount(found, minlength=6)[rows].tolist() == [4] * len(rows)


def test_one_that_is_missed_is_asked_for_twice_and_then_gives_way():
    found = asked_for([0] * 6, 6, answers={5: 2})
    assert found[:3] == [0, 5, 5]
    assert found.count(5) == 2


def test_a_module_that_never_answers_keeps_no_other_waiting():
    found = asked_for([0, 0, 0, 1, 1, 1], 12, answers={0: None, 1: None, 2: None})
    assert np.bincount(np.array(found) // 3).tolist() == [7, 5]
    assert max(len(run) for run in "".join("d" if row < 3 else "." for row in found).split(".")) <= 2
    assert found.count(0) <= 3


def test_a_poked_taxel_without_a_place_does_not_hide_the_others():
    places = LINE.copy()
    places[5] = np.nan
    turns = Turns(places, np.zeros(6, dtype=np.int64), np.zeros(6, dtype=np.int64), np.array([1, 0, 0, 0, 0, 1]))
    assert turns.module_taxel(np.arange(5), np.ones(5)) == 4
    nowhere = Turns(np.full((6, 3), np.nan), turns.modules, turns.asked, turns.own)
    assert nowhere.module_taxel(np.array([2, 3]), np.array([2.0, 1.0])) == 3


def test_of_several_modules_the_one_that_is_reached_soonest_is_next():
    assert asked_for([0, 0, 0, 1, 1, 1], 1, seconds=np.array([3.0, 3.0, 3.0, 2.0, 1.0, 2.0])) == [4]


def test_taxels_take_turns_by_themselves():
    turns = Turns(LINE, np.zeros(6, dtype=np.int64), np.array([1, 2, 0, 3, 0, 0]), np.array([1, 0, 1, 0, 0, 1]))
    assert turns.taxel(np.arange(6), np.array([1.0, 1.0, 1.0, 1.0, 9.0, 1.0])) == 4, "the only one that was not poked"
    # 1 was missed twice and is asked for once more in this round; 3 was missed three times: it waits for the next.
    assert turns.taxel(np.array([0, 1, 3]), np.array([3.0, 2.0, 1.0])) == 1
