"""The messages over UDP: what comes back whole, what is none, and addresses."""

import struct
import time

import pytest

from cosim.errors import UserError
from cosim.hil import udp_messages as messages
from cosim.hil.udp_messages import address_of, packed, unpacked
from tests.cosim.hil.rig import one_sentence

HOST = "127.0.0.1"
COMMAND = messages.COMMAND_BODY.pack(1, 2.5, True, 0.0, 0.0, 1.0)
KINDS = {
    messages.HELLO: b"",
    messages.WELCOME: b"",
    messages.REFUSED: "ähm".encode(),
    messages.START: messages.START_BODY.pack(1e-3, 1),
    messages.COMMAND: COMMAND,
    messages.MEASUREMENT: messages.MEASUREMENT_BODY.pack(3, 4, -5, 6, 0.5, -7.0, 2),
    messages.STOP: b"reason",
    messages.STOPPED: b"",
}


@pytest.mark.parametrize("kind", KINDS)
def test_messages_come_back(kind):
    message = unpacked(packed(kind, 2**32 - 1, 2**32 - 1, KINDS[kind]))
    assert message == (kind, 2**32 - 1, 2**32 - 1, KINDS[kind])


def test_the_header_is_fixed_and_little_endian():
    before = time.perf_counter_ns()
    data = packed(messages.COMMAND, 0x01020304, 5, COMMAND)
    magic, version, kind, size, session, seq, sent = struct.unpack("<4sBBHIIq", data[:24])
    assert (magic, version, kind, size, session, seq) == (b"QIHC", 1, messages.COMMAND, len(COMMAND), 0x01020304, 5)
    assert before <= sent <= time.perf_counter_ns()
    assert len(data) == 24 + len(COMMAND)


@pytest.mark.parametrize("kind", KINDS)
def test_messages_of_another_size_are_none(kind):
    data = packed(kind, 1, 1, KINDS[kind])
    assert unpacked(data + b"x") is None
    assert unpacked(data[:-1]) is None
    if kind not in (messages.REFUSED, messages.STOP):
        assert unpacked(packed(kind, 1, 1, KINDS[kind] + b"x")) is None  # even where the header says so


@pytest.mark.parametrize("length", [0, 1, 23])
def test_less_than_a_header_is_none(length):
    assert unpacked(packed(messages.HELLO, 1, 1)[:length]) is None


@pytest.mark.parametrize(("at", "byte"), [(0, b"X"), (3, b"c"), (4, b"\x00"), (4, b"\x02"), (5, b"\x00"), (5, b"\x09")])
def test_another_magic_version_or_kind_is_none(at, byte):
    data = packed(messages.HELLO, 1, 1)
    assert unpacked(data) is not None
    assert unpacked(data[:at] + byte + data[at + 1 :]) is None


@pytest.mark.parametrize(
    ("text", "address"),
    [
        ("127.0.0.1:5", (HOST, 5)),
        ("bench", ("bench", messages.DEFAULT_PORT)),
        ("bench:0", ("bench", 0)),
        ("h:65535", ("h", 65535)),
    ],
)
def test_addresses(text, address):
    assert address_of(text) == address


@pytest.mark.parametrize("text", ["", ":", ":5", "h:", "h:x", "h:-1", "h:65536", "h:1.5"])
def test_what_is_no_address(text):
    with pytest.raises(UserError, match="host:port") as caught:
        address_of(text)
    one_sentence(caught.value)


@pytest.mark.parametrize(
    ("host", "beyond"), [("127.0.0.1", False), ("127.8.8.8", False), ("0.0.0.0", True), ("192.168.1.2", True)]
)
def test_who_listens_beyond_this_machine_is_known(host, beyond):
    assert messages.beyond_loopback((host, 1)) is beyond
