"""Two units at one receiver, through the bytes: losses, disorder and silence of one unit."""

from __future__ import annotations

import numpy as np
import pytest

from firmware_protocols.known import load_protocol
from firmware_protocols.packets import counts
from imu_rig.imu_scaling import si_factors, si_values
from imu_rig.packet_stream import PacketStreams, assemble_packets
from imu_rig.units import STANDARD_GRAVITY
from simulators.encoders import MadeSamples
from simulators.inertial_sensor import Readings
from simulators.two_imu import TwoImuReceiver, UnitLink

PROTOCOL = load_protocol("two-imu")
NUMBER = 3000
PERIOD_S = 0.02


def samples(number=NUMBER, first=0):
    counter = first + np.arange(number)
    t = (counter + 1) * PERIOD_S
    accel = np.zeros((number, 3))
    accel[:, 0] = counter % 1000 * 0.01  # tells one sample from another
    accel[:, 2] = STANDARD_GRAVITY
    return MadeSamples(
        t=t,
        device_s=t + 4290.0,  # the 32-bit clock comes round after 5 s
        counter=counter,
        readings=Readings(
            accel=accel,
            gyro=np.zeros((number, 3)),
            mag=np.tile([0.0, 22.0, -45.0], (number, 1)),
            temperature=np.full(number, 25.0),
            saturated=np.zeros(number, dtype=bool),
            offsets=np.zeros((number, 6)),
        ),
        pressure=np.full(number, 101_325.0),
        air_c=np.full(number, 25.0),
    )


def made(measured=("foot", "waist"), seed=1, **links):
    receiver = TwoImuReceiver(np.random.default_rng(seed), measured, links)
    receiver.boot(0.0)
    return receiver


def recorded(sent):
    """Bytes, ends of the pieces and when they arrived: one piece per sample, a little late."""
    stops = np.cumsum([len(piece) for piece in sent])
    arrival = 100.0 + PERIOD_S * np.arange(1, len(sent) + 1) + 0.004
    return b"".join(sent), stops, arrival


def assembled(sent):
    streams = assemble_packets(PROTOCOL, *recorded(sent))
    return streams["foot"], streams["waist"]


def common_s(packets):
    """Time of each packet on the receiver's clock, told by the clock alone."""
    return packets.block.device_s - 4290.0 if packets.block.device_s is not None else None


def test_a_perfect_receiver_gives_both_in_turn():
    sent = made().encode(samples(10))
    assert [len(piece) for piece in sent] == [58] * 10
    for piece in sent:
        assert piece[:3] + piece[29:32] == b"\xa5\x62\x01\xa5\x62\x02"


def test_a_lost_fifth_of_one_unit_is_counted_and_the_other_is_untouched():
    foot, waist = assembled(made(foot=UnitLink(loss=0.2)).encode(samples()))

    lost = NUMBER - len(foot.block)
    assert lost == pytest.approx(0.2 * NUMBER, abs=5 * np.sqrt(0.16 * NUMBER))
    inside = int(foot.block.counter[-1] - foot.block.counter[0]) + 1 - len(foot.block)
    assert foot.stats.lost == inside
    assert len(waist.block) == NUMBER
    assert (waist.stats.lost, waist.stats.reordered) == (0, 0)
    np.testing.assert_array_equal(np.diff(waist.block.counter), 1)


def test_late_packets_are_put_in_order_and_none_is_lost():
    """Behind up to eight later ones; what is lost is what came too late to be put in order."""
    sent = made(waist=UnitLink(late=8)).encode(samples())
    foot, waist = assembled(sent)
    came = counts(
        PROTOCOL.streams["waist"],
        PROTOCOL.decoder().feed(b"".join(sent))["waist"].rows,
        "seq",
    )

    assert np.any(np.diff(came) < -4), "this test needs disorder"
    assert np.all(np.diff(waist.block.counter) > 0)
    assert np.all(np.diff(waist.block.t) > 0)
    numbers = waist.block.rows["seq"]
    assert set(numbers.tolist()) == set(came.tolist())
    assert len(foot.block) == NUMBER
    assert foot.stats.reordered == 0


def test_a_silent_unit_leaves_the_other_as_it_is():
    sent = made(foot=UnitLink(loss=1.0)).encode(samples(500))
    foot, waist = assembled(sent)
    assert len(foot.block) == 0
    assert len(waist.block) == 500
    assert waist.stats.lost == 0


def test_units_that_start_and_stop_apart_are_paired_by_the_clock():
    links = {
        "foot": UnitLink(loss=0.2, starts_s=1.3, stops_s=50.0),
        "waist": UnitLink(loss=0.1, late=3, starts_s=0.4, stops_s=57.1),
    }
    foot, waist = assembled(made(**links).encode(samples()))
    assert foot.time_source == waist.time_source == "device clock"

    # By the world's truth: the same counter is the same moment.
    at = dict(zip(waist.block.rows["seq"].tolist(), waist.block.t.tolist(), strict=True))
    pairs = [
        (t, at[n])
        for n, t in zip(foot.block.rows["seq"].tolist(), foot.block.t.tolist(), strict=True)
        if n in at
    ]
    assert len(pairs) > 0.6 * 0.8 * 2435
    apart = np.abs(np.diff(np.array(pairs), axis=1))
    assert apart.max() < 1e-3
    by_row = foot.block.t[:1000] - waist.block.t[:1000]
    assert np.median(np.abs(by_row)) > 0.1, "pairing by row would be wrong"


def test_live_packets_are_the_recorded_ones():
    sent = made(foot=UnitLink(loss=0.2)).encode(samples(250))
    data, stops, arrival = recorded(sent)
    live = PacketStreams(PROTOCOL)
    rows = {"foot": [], "waist": []}
    for piece, moment in zip(sent, arrival, strict=True):
        for name, block in live.feed_many([(round(moment * 1e9), piece)]).items():
            rows[name] += block.rows["seq"].tolist()
    whole = assemble_packets(PROTOCOL, data, stops, arrival)

    for name in ("foot", "waist"):
        recorded_rows = whole[name].block.rows["seq"].tolist()
        assert rows[name] == recorded_rows[: len(rows[name])]
        assert len(recorded_rows) - len(rows[name]) <= 1
        assert live.stats(name).lost == whole[name].stats.lost


@pytest.mark.parametrize(
    ("measured", "still"), [(("foot",), "waist"), (("waist",), "foot"), (("foot", "waist"), None)]
)
def test_what_is_not_on_the_jig_lies_still(measured, still):
    rows = PROTOCOL.decoder().feed(b"".join(made(measured).encode(samples(900))))
    for name, layout in PROTOCOL.streams.items():
        read = si_values(layout, rows[name].rows, si_factors(layout))
        moved = np.std(read["accel"][:, 0])
        assert (moved < 0.05) == (name == still)
        assert np.mean(read["accel"][:, 2]) == pytest.approx(STANDARD_GRAVITY, abs=0.8)


def test_two_units_on_one_plate_err_each_in_its_own_way():
    rows = PROTOCOL.decoder().feed(b"".join(made().encode(samples(900))))
    foot, waist = (
        si_values(layout, rows[name].rows, si_factors(layout))["accel"]
        for name, layout in PROTOCOL.streams.items()
    )
    assert np.abs(np.mean(foot - waist, axis=0)).max() > 0.02
    assert np.abs(foot - waist).max() < 1.5


def test_how_samples_are_cut_into_calls_changes_nothing():
    links = {"foot": UnitLink(loss=0.3, late=5), "waist": UnitLink(loss=0.1)}
    whole = b"".join(made(("foot",), **links).encode(samples(100)))
    cut = made(("foot",), **links)
    parts = [cut.encode(samples(n, first)) for first, n in ((0, 1), (1, 2), (3, 97))]
    assert b"".join(piece for part in parts for piece in part) == whole
