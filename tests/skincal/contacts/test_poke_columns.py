"""Columns of all pokes against a plain loop over them."""

import numpy as np
import pytest

from skincal.contacts.outcome import Contact, Reason, Rejection
from skincal.contacts.poke_columns import GrowingPokeColumns, PokeColumns


def outcome(poke, pose, channels=(3, 5), is_contact=True):
    channels = np.array(channels)
    if not is_contact:
        return Rejection(poke, 0.0, 0.3, Reason.SLID, 0.003, 0.0015, "m", channels, True, pose=pose)
    return Contact(poke, 0.0, 0.3, np.zeros(3), np.zeros(3), channels, 10.0 + channels, np.eye(4), pose, np.nan, True)


def some_pokes(seed, count=200):
    rng = np.random.default_rng(seed)
    return [
        (outcome(1 + at, f"pose {rng.integers(6)}", rng.choice(20, 3, replace=False), rng.random() < 0.8), rng.random() < 0.1)
        for at in range(count)
    ]


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("most", [1, 2, 4, 6, 10])
def test_the_last_counting_poke_of_the_most_used_poses_is_found_in_the_order_of_their_first_pokes(seed, most):
    pokes = some_pokes(seed)
    first, last, counts = {}, {}, {}
    for row, (each, is_excluded) in enumerate(pokes):
        if isinstance(each, Contact) and not is_excluded:
            first.setdefault(each.pose, row)
            last[each.pose] = row
            counts[each.pose] = counts.get(each.pose, 0) + 1
    kept = sorted(counts, key=lambda pose: (-counts[pose], first[pose]))[:most]
    wanted = [(pose, last[pose]) for pose in sorted(kept, key=first.__getitem__)]
    assert list(PokeColumns.collect(pokes).last_rows_of_poses(most).items()) == wanted


def test_without_a_counting_poke_no_pose_has_a_row():
    assert PokeColumns.collect([]).last_rows_of_poses(3) == {}
    assert PokeColumns.collect([(outcome(1, "a", is_contact=False), False)]).last_rows_of_poses(3) == {}


def test_a_poke_takes_the_place_of_an_earlier_one_with_its_number():
    pokes, growing = some_pokes(7), GrowingPokeColumns()
    for each, is_excluded in pokes[::-1]:
        growing.store(outcome(each.poke, "another"), not is_excluded)
    before = growing.now()
    kept = before.counting.copy()
    for each, is_excluded in pokes:
        growing.store(each, is_excluded)
    now, wanted = growing.now(), PokeColumns.collect(pokes)
    for name in ("numbers", "counting", "excluded", "strongest"):
        assert np.array_equal(getattr(now, name), getattr(wanted, name)), name
    assert [now.pose_names[pose] for pose in now.poses] == [wanted.pose_names[pose] for pose in wanted.poses]
    assert np.array_equal(before.counting, kept), "an earlier answer stays as it was"
