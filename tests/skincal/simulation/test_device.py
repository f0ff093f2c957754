from dataclasses import replace

import numpy as np
import pytest
from cobs import cobs as reference_cobs
from hypothesis import given
from hypothesis import strategies as st

from skincal.cli.simulate import SERVED_MOMENT_NOISE_NM
from skincal.model.readings import Loss, Stream
from skincal.simulation.board_formats import SkbEncoder, SktEncoder, cobs, make_encoder
from skincal.simulation.device import DeviceSettings, DeviceTimeline
from skincal.simulation.operator import AutoOperator, Habits, HandPress, Move, PokeOrder, PoseOrder, ScriptedOperator
from skincal.simulation.rig_errors import RigErrors
from skincal.simulation.simulated_rig import Rig
from skincal.streams.decoders.auto_detect import make_decoder
from tests.skincal.sim_support import make_rig, scene_and_surface

QUIET = DeviceSettings(start_quiet_s=0.2)


def play(errors, seconds, seed=1, name="icub-forearm", settings=None, operator=None):
    """Return the time line after so long, and all that arrived."""
    rig = make_rig(errors, seed, name)
    rng = np.random.default_rng(seed)
    line = DeviceTimeline(rig, operator(rig, rng) if operator else AutoOperator(rig, Habits.careful(), rng), rng, settings)
    arrived = []
    while line.now < seconds:
        arrived += line.advance()
    return line, arrived


def told(order, **habits):
    """Make an operator of `play` that gets one order, made from the rig."""

    def operator(rig, rng):
        scripted = ScriptedOperator(rig, replace(Habits.careful(), **habits), rng)
        scripted.accept(order(rig))
        return scripted

    return operator


def decode(line, arrived, link, form="skb"):
    """Decode one link; return the decoder, device times and values."""
    channels = line.rig.scene.skin.channels
    decoder = make_decoder(form, channels, (line.links[link],))
    batches = [batch for _, name, data in arrived if name == link for batch in decoder.feed(data)]
    return decoder, np.concatenate([b.device_s for b in batches]), np.concatenate([b.values for b in batches])


@given(st.binary(max_size=1100) | st.lists(st.sampled_from([0, 1, 255]), max_size=700).map(bytes))
def test_cobs_is_that_of_the_reference_package(data):
    assert cobs(data) == reference_cobs.encode(data)


@pytest.mark.parametrize("size", [0, 253, 254, 255, 508, 509, 762])
def test_cobs_at_the_edges_of_its_blocks(size):
    for data in (bytes([7]) * size, bytes([7]) * size + b"\x00", b"\x00" + bytes([7]) * size + b"\x00\x07"):
        assert cobs(data) == reference_cobs.encode(data)


def after(encoder, number, stream):
    encoder._next_number[stream] = number
    return encoder


def test_records_are_those_of_the_protocol():
    # The worked examples of the protocol's description, byte for byte.
    skin = after(SkbEncoder("u16"), 17, Stream.SKIN).record(Stream.SKIN, 340000, [201.0, 199, 2310, 200])
    assert skin.hex() == "020102110420300502c902c7040609c803f32e00"
    wrench = [1.5, -2.25, 30, 0.125, -0.5, 0.0625]
    assert after(SkbEncoder(), 1234, Stream.WRENCH).record(Stream.WRENCH, 1234000, wrench).hex() == (
        "020206d20450d412010103c03f010310c00103f0410101023e010102bf0103803d0101010366ec00"
    )
    line = after(SktEncoder(), 17, Stream.SKIN).record(Stream.SKIN, 340000, [201.0, 199, 2310, 200])
    assert line == b"T,17,340000,201,199,2310,200*E4DB\n"
    header = SktEncoder().header(0, "board=left-forearm-A,n=84,rate=50,unit=raw,bits=12", 84)
    assert header == b"H,skt1,board=left-forearm-A,n=84,rate=50,unit=raw,bits=12*C2AD\n"


def test_skin_values_are_as_narrow_as_the_range_allows():
    lengths = {top: len(make_encoder("skb", top, 64).record(Stream.SKIN, 1, [9.0] * 64)) for top in (255, 4095, 1e6)}
    assert 64 + 10 < lengths[255] < 64 + 16
    assert 128 + 10 < lengths[4095] < 128 + 16
    assert 256 + 10 < lengths[1e6] < 256 + 16


@pytest.mark.parametrize("form", ["skb", "skt", "text"])
def test_decoders_read_what_the_boards_say(form):
    line, arrived = play(RigErrors.none(), 1.5, settings=DeviceSettings(format=form))
    for link, rate, width in (("wrench", 1000, 6), ("skin", 50, 384), ("joints", 100, 5)):
        decoder, times, values = decode(line, arrived, link, form)
        assert decoder.counts.total() == 0
        # A decoder may leave out the record with which it began; nothing else is missing.
        assert len(values) in (int(1.5 * rate), int(1.5 * rate) - 1)
        assert values.shape[1] == width
        np.testing.assert_allclose(np.diff(times), 1 / rate, atol=2e-6)


@pytest.mark.parametrize("form", ["skb", "skt", "text"])
def test_a_served_sensor_without_noise_does_not_look_frozen(form):
    line, arrived = play(RigErrors.none(), 1.5, settings=DeviceSettings(format=form, flicker=SERVED_MOMENT_NOISE_NM))
    _, _, wrenches = decode(line, arrived, "wrench", form)
    differs = (np.diff(wrenches, axis=0) != 0).any(axis=1)
    assert differs.mean() > 0.6
    still = decode(*play(RigErrors.none(), 1.5, settings=DeviceSettings(format=form)), "wrench", form)[2]
    np.testing.assert_allclose(wrenches, still[: len(wrenches)], atol=2 * SERVED_MOMENT_NOISE_NM)


def test_the_forearm_sends_its_pose_in_degrees():
    line, arrived = play(RigErrors.none(), 0.5)
    _, _, angles = decode(line, arrived, "joints")
    np.testing.assert_allclose(np.degrees(angles), np.tile([0, 0, 0, 94.0, 0], (len(angles), 1)), atol=1e-5)


def test_wide_skins_speak_text_since_no_record_holds_them():
    # Without its surface each module lies in its anchor's plane: quicker, and the same bytes.
    rig = Rig(scene_and_surface("whole-body")[0], None, RigErrors.none(), np.random.default_rng(1))
    rng = np.random.default_rng(1)
    line = DeviceTimeline(rig, AutoOperator(rig, Habits.careful(), rng), rng)
    arrived = [item for _ in range(30) for item in line.advance()]
    assert set(line.links) == {"wrench", "skin"}
    decoder, _, values = decode(line, arrived, "skin", "text")
    assert values.shape == (15, 4200)
    assert decoder.counts.total() == 0
    np.testing.assert_array_equal(values, 240)


def test_same_seed_same_bytes_and_another_seed_others():
    one, two = play(RigErrors.paper(), 3.0, 5)[1], play(RigErrors.paper(), 3.0, 5)[1]
    assert one == two
    assert play(RigErrors.paper(), 3.0, 6)[1] != one


def test_the_same_poke_gives_the_truth_over_the_wire():
    # A perfect rig told to poke once: the mean of the held readings is the true wrench, and the foam answers as computed.
    steady = {"tremor": 0.0, "approach_s": (0.5, 0.5), "hold_s": (0.5, 0.5), "rest_s": (1, 1)}
    poke_once = told(lambda rig: PokeOrder(int(rig.channels[30]), np.radians(20), 1.0, 8.0), **steady)
    line, arrived = play(RigErrors.none(), 1.8, settings=QUIET, operator=poke_once)
    press = next(a for a in line._actions if isinstance(a, HandPress))
    _, times, wrenches = decode(line, arrived, "wrench")
    since = times - times[0]
    held = (since > press.begin + press.ramp + 0.01) & (since < press.begin + press.ramp + 0.49)
    truth = line.rig.true_wrenches(press.pokes.points, press.pokes.forces[:, None] * press.pokes.directions, line.arm_pose)[0]
    assert held.sum() > 400
    np.testing.assert_allclose(wrenches[held], np.tile(truth, (held.sum(), 1)), rtol=1e-6, atol=1e-6)
    np.testing.assert_allclose(wrenches[since < press.begin - 0.01], 0.0)
    _, skin_times, frames = decode(line, arrived, "skin")
    skin_since = skin_times - skin_times[0]
    pressed = frames[(skin_since > press.begin + press.ramp + 0.03) & (skin_since < press.begin + press.ramp + 0.45)]
    rows, values = line.rig.answers(press.pokes, press.pokes.forces)
    expected = np.full(84, 240.0)
    expected[rows[0]] -= values[0]
    np.testing.assert_array_equal(pressed[:, line.rig.channels], np.tile(np.rint(expected), (len(pressed), 1)))
    assert expected.min() < 200


def test_the_foam_answers_later_than_the_force():
    press_hard = told(lambda rig: PokeOrder(int(rig.channels[30]), 0.0, 0.0, 12.0), ramp_s=(0.2, 0.2))
    line, arrived = play(RigErrors.none(), 1.2, settings=replace(QUIET, skin_hz=1000.0), operator=press_hard)
    press = next(a for a in line._actions if isinstance(a, HandPress))
    _, times, frames = decode(line, arrived, "skin")
    channel = line.rig.channels[30]
    depth = 240 - frames[:, channel]
    half_way = times[np.argmax(depth > depth.max() * 0.2)] - times[0]
    load = press.load(np.array([half_way - line.rig.foam.lag, half_way]))
    rows, values = line.rig.answers(press.pokes, load[:1] * press.pokes.forces)
    assert values[0][rows[0] == 30] == pytest.approx(depth.max() * 0.2, abs=1.5)
    assert load[1] > load[0]


def test_wrench_sign_is_the_sensors():
    press_straight = told(lambda _: PokeOrder(0, 0.0, 0.0, 10.0))
    results = []
    for sign in (1, -1):
        scene, _ = scene_and_surface("flat-patch")
        rig = Rig(replace(scene, wrench_sign=sign), None, RigErrors.none(), np.random.default_rng(1))
        rng = np.random.default_rng(2)
        line = DeviceTimeline(rig, press_straight(rig, rng), rng, QUIET)
        arrived = []
        while line.now < 1.5:
            arrived += line.advance()
        results.append(decode(line, arrived, "wrench")[2])
    assert results[0][:, 2].min() < -9
    np.testing.assert_array_equal(results[1], -results[0])


def test_losses_are_visible_and_of_the_stated_size():
    errors = replace(RigErrors.none(), dropped=2e-4, corrupted=2e-4)
    line, arrived = play(errors, 4.0, name="flat-patch")
    decoder, _, values = decode(line, arrived, "wrench")
    sent = 4000
    spoiled = sent * 40 * 4e-4  # each byte hurts one record of 40
    assert sent - len(values) == pytest.approx(spoiled, rel=0.5)
    assert decoder.counts[Loss.MISSING] == pytest.approx(sent - len(values), abs=5)
    assert decoder.counts[Loss.BAD_CHECKSUM] + decoder.counts[Loss.UNREADABLE] > 20


def test_links_delay_and_hold_back_but_keep_the_order():
    errors = replace(RigErrors.noise(), burst_rate=2.0)
    line, arrived = play(errors, 4.0, name="flat-patch")
    stamps = np.array([at for at, _, _ in arrived])
    assert (np.diff(stamps) >= 0).all()
    for link, latency in (("wrench", errors.wrench_latency), ("skin", errors.skin_latency)):
        decoder = make_decoder("skb", 64, (line.links[link],))
        lateness = []
        first = None
        for at, name, data in arrived:
            for batch in decoder.feed(data) if name == link else ():
                first = batch.device_s[0] if first is None else first
                lateness.append(at * 1e-9 - (batch.device_s[-1] - first))
        assert min(lateness) >= latency - 1e-3
        assert min(lateness) < latency + 0.012
        assert max(lateness) > latency + 0.03


def test_device_clocks_begin_anywhere_and_run_at_their_own_pace():
    starts, rates = [], []
    for seed in range(4):
        line, arrived = play(replace(RigErrors.none(), clock_skew=0.01), 2.0, seed, "flat-patch")
        for link, hz in (("wrench", 1000), ("skin", 50)):
            _, times, _ = decode(line, arrived, link)
            starts.append(times[0])
            rates.append(np.median(np.diff(times)) * hz)
    assert np.ptp(starts) > 500
    assert 0.002 < np.std(rates) < 0.03


def test_a_clock_that_wraps_goes_on():
    line, _ = play(RigErrors.none(), 0.05, name="flat-patch")
    board = line._boards[0]
    board.clock._start = 2**32 / 1e6 - 0.1
    stamps = board.clock.us(np.array([0.0, 0.2]))
    assert stamps[0] > stamps[1] == 100_000


def test_boards_say_what_they_are_at_the_start_and_every_two_seconds():
    _, arrived = play(RigErrors.none(), 4.5, name="flat-patch", settings=DeviceSettings(format="skt"))
    lines = b"".join(data for _, name, data in arrived if name == "skin").splitlines()
    headers = [i for i, text in enumerate(lines) if text.startswith(b"H,skt1,")]
    assert len(headers) == 3
    assert headers[0] == 0
    assert b",n=64," in lines[0]
    assert b",bits=12," in lines[0]
    assert b",polarity=up," in lines[0]


def test_the_arm_moves_between_poses_and_the_weight_with_it():
    move_once = told(lambda _: PoseOrder("2"), move_s=0.5)
    line, arrived = play(replace(RigErrors.none(), weight=8.0), 1.0, settings=QUIET, operator=move_once)
    _, times, angles = decode(line, arrived, "joints")
    degrees, since = np.degrees(angles[:, 3:]), times - times[0]
    np.testing.assert_allclose(degrees[since < 0.18], [[94, 0]] * int((since < 0.18).sum()), atol=1e-4)
    np.testing.assert_allclose(degrees[since > 0.75], [[15, -90]] * int((since > 0.75).sum()), atol=1e-4)
    assert (np.diff(degrees[:, 0]) <= 1e-4).all()
    _, _, wrenches = decode(line, arrived, "wrench")
    one, two = line.rig.arm_pose("1"), line.rig.arm_pose("2")
    np.testing.assert_allclose(wrenches[0], one.weight, atol=1e-5)
    np.testing.assert_allclose(wrenches[-1], two.weight, atol=1e-5)
    assert np.linalg.norm(one.weight[:3]) == pytest.approx(8.0)
    assert line.arm_pose is two
    assert not any(isinstance(a, Move) for a in line._actions)


def test_a_finite_time_line_ends_after_the_last_rest():
    rig = make_rig(RigErrors.noise(), 1, "flat-patch")
    rng = np.random.default_rng(1)
    line, arrived = DeviceTimeline(rig, AutoOperator(rig, Habits.careful(), rng, pokes=2), rng), []
    while not line.finished:
        arrived += line.advance()
    assert 3.0 < arrived[-1][0] * 1e-9 < 9.0
    assert {name for _, name, _ in arrived} == {"wrench", "skin"}


@pytest.mark.parametrize(
    ("errors", "settings"),
    [
        (RigErrors.paper(), DeviceSettings(start_quiet_s=0.1)),
        (RigErrors.none(), DeviceSettings(start_quiet_s=0.1, format="skt", wrench_hz=1004.0, skin_hz=35.0, joints_hz=7.0)),
    ],
)
@pytest.mark.parametrize("count", [7, 1000])
def test_many_blocks_at_once_are_the_blocks_one_after_the_other(errors, settings, count):
    habits = Habits(slide_rate=0.5, double_rate=0.5).at_pace(4.0)

    def line():
        rig = make_rig(errors, 1, "icub-forearm")
        hands = np.random.default_rng(2)
        operator = AutoOperator(rig, habits, hands, 3, list(rig.arm_poses)[:2])
        return DeviceTimeline(rig, operator, np.random.default_rng(3), settings)

    alone, together = line(), line()
    known, made = [], []
    while not alone.finished:
        arrived = alone.advance()
        known.append((alone.now, arrived))
    while not together.finished:
        made += together.advance_many(count)
    assert made == known
