"""Every built-in protocol against noise, torn packets and damage; see the harness for 10 MB."""

import numpy as np
import pytest
from fuzz_harness import STREAMS, Stream, check, decode, packets_of

from firmware_protocols.known import builtin_protocols

SIZE = 40_000
PROTOCOLS = list(builtin_protocols())


@pytest.fixture(scope="module")
def captures():
    """A short recording of every protocol."""
    return {name: b"".join(packets_of(p, 200)) for name, p in builtin_protocols().items()}


@pytest.mark.parametrize("name", PROTOCOLS)
@pytest.mark.parametrize("kind", STREAMS)
def test_nothing_false_comes_out_and_nothing_whole_is_lost(name, kind):
    protocol = builtin_protocols()[name]
    stream = STREAMS[kind](protocol, SIZE, np.random.default_rng(1))
    outcome = decode(protocol, stream)
    check(protocol, outcome)
    assert outcome.packets >= 0.95 * len(stream.ends)
    # In other pieces it is the same.
    for chunk_bytes in (len(stream.data), 1009):
        again = decode(protocol, stream, chunk_bytes)
        assert (again.packets, again.false, again.missing, again.tries) == (
            outcome.packets,
            outcome.false,
            outcome.missing,
            outcome.tries,
        )


@pytest.mark.parametrize("name", PROTOCOLS)
def test_whole_packets_are_all_there(name):
    protocol = builtin_protocols()[name]
    packets = packets_of(protocol, 300)
    stream = Stream(b"".join(packets), np.cumsum([len(packet) for packet in packets]))
    outcome = decode(protocol, stream)
    assert (outcome.packets, outcome.false, outcome.missing) == (300, 0, 0)
    assert outcome.tries == 300


@pytest.mark.parametrize("name", PROTOCOLS)
def test_another_device_on_the_port_gives_nothing(name, captures):
    """Each protocol hears what every other one sends; those of a family share their frames."""
    protocol = builtin_protocols()[name]
    kind = protocol.to_dict().get("kind")
    for other_name, other in builtin_protocols().items():
        if other_name == name or (kind and other.to_dict().get("kind") == kind):
            continue
        stream = Stream(captures[other_name], np.empty(0, dtype=np.int64))
        check(protocol, decode(protocol, stream))
