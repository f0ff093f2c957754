"""The pipeline from bytes of two devices to estimates."""

import dataclasses

import numpy as np
import pytest

from skincal.contacts.outcome import Contact, PressPhase, Reason
from skincal.geometry import Arm, DhLink
from skincal.model.actions import SetPose
from skincal.model.errors import InputError
from skincal.model.readings import Chunk, LinkEvent, LinkState, Loss, Stream
from skincal.model.scene import ArmSpec
from skincal.session.pipeline import Pipeline
from skincal.streams.links import LinkSpec
from tests.build import feed
from tests.skincal.poke_script import LINKS, Script, as_chunks, same_estimates, skt_line, small_scene, some_pokes

FORCE = np.array([1.0, 2.0, -8.0])
POINT = np.array([0.02, 0.05, 0.10])
ANSWERS = {3: 80.0, 7: 40.0}


def played(items, scene=None, links=LINKS):
    return feed(Pipeline(scene or small_scene(), links, None), list(items))


def outcomes_of(pipeline):
    return [poke.outcome for poke in pipeline.snapshot().pokes]


def test_bytes_become_contacts_with_the_numbers_of_the_truth():
    pipeline = played(as_chunks(Script(small_scene()).quiet().press(FORCE, POINT, ANSWERS).quiet().samples))
    (contact,) = outcomes_of(pipeline)
    assert isinstance(contact, Contact)
    assert contact.final
    np.testing.assert_allclose(contact.force, FORCE, atol=2e-6)  # the text has six digits
    np.testing.assert_allclose(contact.moment, np.cross(POINT, FORCE), atol=2e-6)
    np.testing.assert_allclose(contact.responses, [80.0, 40.0], atol=0.02)


def test_the_reaction_is_turned_where_the_scene_says_so():
    script = Script(small_scene()).quiet().press(-FORCE, POINT, ANSWERS).quiet()
    pipeline = played(as_chunks(script.samples), dataclasses.replace(small_scene(), wrench_sign=-1))
    np.testing.assert_allclose(outcomes_of(pipeline)[0].force, FORCE, atol=2e-6)


def test_how_the_bytes_are_cut_changes_nothing():
    items = as_chunks(some_pokes(small_scene(), 4).samples)
    pieces = []
    for item in items:
        if isinstance(item, Chunk):
            half = len(item.data) // 3
            pieces += [dataclasses.replace(item, data=part) for part in (item.data[:half], item.data[half:])]
        else:
            pieces.append(item)
    assert same_estimates(played(items).snapshot(), played(pieces).snapshot())


def test_the_live_view_shows_what_the_devices_say():
    items = as_chunks(Script(small_scene()).quiet().press(FORCE, POINT, ANSWERS).samples)
    pipeline = played(items[:-12])
    now = items[-12].host_ns
    live = pipeline.live(now)
    assert live.progress.phase is PressPhase.HELD
    assert live.skin[3] == pytest.approx(80.0, abs=0.01)
    assert live.wrench_s[-1] - live.wrench_s[0] == pytest.approx(1.6, abs=0.2)
    np.testing.assert_allclose(live.wrench[0], [3.0, -2.0, 20.0, 0.1, -0.3, 0.05])
    assert [link.state for link in live.links] == [LinkState.OPEN, LinkState.OPEN]
    assert pipeline.live(now + 1_500_000_000).progress.phase is PressPhase.HELD
    assert pipeline.live(now + 2_100_000_000).progress.phase is PressPhase.NO_DATA


def test_a_port_that_vanishes_in_a_poke_costs_that_poke_alone():
    script = Script(small_scene()).quiet().press(FORCE, POINT, ANSWERS).quiet().press(FORCE, POINT, ANSWERS)
    items = as_chunks(script.samples)[:-30]
    lost_ns = items[-1].host_ns + 100_000_000
    back = [dataclasses.replace(item, host_ns=item.host_ns + 20_000_000_000) for item in as_chunks(script.quiet().samples)]
    pipeline = played([*items, LinkEvent("skin", lost_ns, LinkState.LOST, "unplugged"), *back])
    kinds = [poke.reason if not isinstance(poke, Contact) else "contact" for poke in outcomes_of(pipeline)]
    assert kinds == ["contact", Reason.READINGS_LOST, "contact", "contact"]
    assert all(poke.final for poke in outcomes_of(pipeline))


@pytest.mark.parametrize("end", ["closed", "ended"])
def test_a_poke_that_is_held_at_the_end_of_a_session_counts(end):
    items = as_chunks(Script(small_scene()).quiet().press(FORCE, POINT, ANSWERS).samples)[:-12]
    pipeline = played(items)
    if end == "closed":
        pipeline.close()
    else:
        for link in pipeline.links:
            pipeline.feed(LinkEvent(link.name, items[-1].host_ns, LinkState.ENDED))
    assert [type(poke) for poke in outcomes_of(pipeline)] == [Contact]


@pytest.mark.parametrize("end", ["closed", "ended"])
@pytest.mark.parametrize("silent", ["skin", "wrench"])
def test_a_poke_is_lost_if_a_device_is_silent_until_the_session_ends(silent, end):
    """The other device goes on for 11 s: nothing says what happened to the poke since."""
    held = as_chunks(Script(small_scene()).quiet().press(FORCE, POINT, ANSWERS, hold_s=12.0).samples)[:-12]
    silent_ns = held[0].host_ns + 4_000_000_000
    pipeline = played(item for item in held if item.link != silent or item.host_ns < silent_ns)
    if end == "closed":
        pipeline.close()
    else:
        for link in pipeline.links:
            pipeline.feed(LinkEvent(link.name, held[-1].host_ns, LinkState.ENDED))
    (poke,) = outcomes_of(pipeline)
    assert poke.reason is Reason.READINGS_LOST


@pytest.mark.parametrize("late_s", [0.0, 0.5])
def test_a_poke_counts_although_the_last_samples_before_the_end_are_on_their_way(late_s):
    script = Script(small_scene()).quiet().press(FORCE, POINT, ANSWERS, hold_s=2.0)
    items = as_chunks(script.samples)[:-12]
    until_ns = items[-1].host_ns - round(late_s * 1e9)
    pipeline = played(item for item in items if item.link != "skin" or item.host_ns <= until_ns)
    pipeline.close()
    assert [type(poke) for poke in outcomes_of(pipeline)] == [Contact]


def repeating(items, since_ns, until_ns, *, zeros=False):
    """The same bytes, but in between the sensor repeats its last reading, or zeros, under new numbers and times."""
    held = next(item for item in items if isinstance(item, Chunk) and item.link == "wrench" and item.host_ns >= since_ns)
    values = [b"0"] * 6 if zeros else held.data.split(b"*")[0].split(b",")[3:]
    for item in items:
        if item.link == "wrench" and isinstance(item, Chunk) and since_ns <= item.host_ns < until_ns:
            head = item.data.split(b",")[:3]
            yield dataclasses.replace(item, data=skt_line(b",".join([*head, *values]).decode()))
        else:
            yield item


def test_a_sensor_that_freezes_in_a_poke_costs_that_poke_and_no_other():
    def pokes(freeze):
        script = some_pokes(small_scene(), 1).quiet(0.5).press(FORCE, POINT, ANSWERS, hold_s=2.0).quiet(0.6)
        items = as_chunks(script.press(FORCE, POINT, ANSWERS).quiet(0.6).samples, per_frame=1)
        begun = next(i for i, s in enumerate(script.samples) if i > 150 and abs(s.wrench[2] - script.samples[0].wrench[2]) > 4)
        since_ns = round(script.samples[begun + 20].host_s * 1e9)
        return outcomes_of(played(repeating(items, since_ns, since_ns + freeze * 1_000_000)))

    assert [isinstance(poke, Contact) for poke in pokes(900)] == [True, True, True]
    first, frozen, last = pokes(1400)
    assert isinstance(first, Contact)
    assert frozen.reason is Reason.READINGS_LOST
    assert isinstance(last, Contact)


def test_the_end_of_the_last_recording_settles_the_last_poke():
    items = as_chunks(Script(small_scene()).quiet().press(FORCE, POINT, ANSWERS).quiet(0.1).samples)
    pipeline = played(items)
    assert not outcomes_of(pipeline)[0].final
    end = items[-1].host_ns
    pipeline.feed(LinkEvent("wrench", end, LinkState.ENDED))
    assert not outcomes_of(pipeline)[0].final
    pipeline.feed(LinkEvent("skin", end, LinkState.ENDED))
    assert outcomes_of(pipeline)[0].final


def test_a_poke_is_measured_while_samples_come_from_a_sensor_that_lives():
    items = as_chunks(Script(small_scene()).quiet().samples)
    pipeline, now_ns = played(items), items[-1].host_ns
    assert not Pipeline(small_scene(), LINKS, None).can_measure(now_ns)
    assert pipeline.can_measure(now_ns)
    for link in LINKS:
        played_on = played(items)
        played_on.feed(LinkEvent(link.name, now_ns, LinkState.LOST))
        assert not played_on.can_measure(now_ns), link.name
    items = as_chunks(Script(small_scene(), force_noise=0.1).quiet(5.0).samples, per_frame=1)
    end_ns = items[-1].host_ns
    assert played(items).can_measure(end_ns)
    assert not played(repeating(items, end_ns - 2_000_000_000, end_ns)).can_measure(end_ns), "frozen"
    assert not played(repeating(items, 0, end_ns)).can_measure(end_ns), "never changed"


def test_a_sensor_that_never_changed_gives_no_poke_and_the_first_that_counts_is_of_one_that_lives():
    """A driver that repeats zeros until its sensor is there: then the load of the whole rig comes at once."""
    script = Script(small_scene(), force_noise=0.02).quiet(2.0).press(FORCE, POINT, ANSWERS).quiet(1.0)
    woken_s = script.now
    script.quiet(14.0).press(FORCE, POINT, ANSWERS).quiet(0.6)
    pipeline = Pipeline(small_scene(), LINKS, None)
    for item in repeating(as_chunks(script.samples, per_frame=1), 0, round(woken_s * 1e9), zeros=True):
        pipeline.feed(item)
    first, contact = outcomes_of(pipeline)
    assert first.reason is Reason.NO_TARE
    assert first.start_s >= woken_s
    assert isinstance(contact, Contact)
    np.testing.assert_allclose(contact.force, FORCE, atol=0.1)


def arm_scene():
    chain = (DhLink(0.1, 0.0, 0.0, 0.0), DhLink(0.2, 0.0, 0.5, 0.0))
    return small_scene(arm=ArmSpec(Arm((1, 2), chain, np.eye(4)), {"up": np.array([0.1, 0.2]), "down": np.array([0.4, 0.6])}))


def test_a_chosen_pose_goes_into_the_contact():
    scene = arm_scene()
    pipeline = Pipeline(scene, LINKS, None)
    assert pipeline.live(0).link_from_sensor is None
    one = dataclasses.replace(scene, arm=dataclasses.replace(scene.arm, poses={"up": np.array([0.1, 0.2])}))
    assert Pipeline(one, LINKS, None).live(0).pose == "up", "the only pose needs no choice"
    pipeline.act(SetPose("down"), 0)
    assert pipeline.live(0).pose == "down"
    items = as_chunks(Script(scene).quiet().press(FORCE, POINT, ANSWERS).quiet().samples)
    for item in items:
        pipeline.feed(item)
    assert pipeline.can_measure(items[-1].host_ns)
    assert not played(items, scene).can_measure(items[-1].host_ns), "where no pose is known a poke is of no use"
    (contact,) = outcomes_of(pipeline)
    assert contact.pose == "down"
    np.testing.assert_array_equal(contact.link_from_sensor, scene.arm.arm.link_from_sensor(np.array([0.4, 0.6])))


def test_streamed_joints_give_the_pose_and_its_name():
    scene = arm_scene()
    links = (*LINKS, LinkSpec("joints", "file:none", (Stream.JOINTS,), "skt"))
    items = as_chunks(Script(scene).quiet().press(FORCE, POINT, ANSWERS).quiet().samples)
    degrees = np.degrees([0.9, 0.4002, 0.5999, 0.7])  # columns 1 and 2 are the arm's
    line = "J,{},{},{}"
    for k, item in enumerate(list(items)):
        if isinstance(item, Chunk) and item.link == "wrench":
            body = line.format(k & 0xFFFF, k * 10_000, ",".join(f"{value:.4f}" for value in degrees))
            items.append(Chunk("joints", item.host_ns - 5_000_000, skt_line(body)))
    items.append(LinkEvent("joints", items[0].host_ns, LinkState.OPEN))
    pipeline = played(sorted(items, key=lambda item: item.host_ns), scene, links)
    (contact,) = outcomes_of(pipeline)
    assert isinstance(contact, Contact), contact
    assert contact.pose == "down"
    np.testing.assert_allclose(contact.link_from_sensor, scene.arm.arm.link_from_sensor(np.array([0.4002, 0.5999])), atol=1e-5)


def test_bad_bytes_are_counted_and_the_pokes_survive():
    items = as_chunks(some_pokes(small_scene(), 3).samples)
    rng = np.random.default_rng(8)
    for k in rng.choice(len(items), 20, replace=False):
        if isinstance(items[k], Chunk):
            data = bytearray(items[k].data)
            data[int(rng.integers(len(data)))] ^= 0x41
            items[k] = dataclasses.replace(items[k], data=bytes(data))
    pipeline = played(items)
    losses = [sum(link.losses.values()) for link in pipeline.live(items[-1].host_ns).links]
    assert sum(losses) >= 10
    assert any(Loss.BAD_CHECKSUM in link.losses for link in pipeline.live(0).links)
    assert sum(isinstance(poke, Contact) for poke in outcomes_of(pipeline)) >= 2


def test_bytes_of_an_unknown_link_are_refused():
    with pytest.raises(InputError, match="nobody"):
        played([Chunk("nobody", 1, b"x")])
