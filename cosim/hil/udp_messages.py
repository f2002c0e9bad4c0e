"""The messages between the loop and a simulated device in another process, over UDP.

Little-endian. Each message has a header: magic, version, kind, body's size, session, sequence number, time of sending [ns].
Of another session, sender, version or size it is dropped and counted; with a sequence number that is not new it is late or a
duplicate and never applied. Free-running, the device samples by its own clock and both sides take the newest message; in
lockstep one command is one period, and a message that got lost is sent again, so that the run is the same to the last bit as
with the device in the loop's process.
"""

from __future__ import annotations

import ipaddress
import struct
import time
from typing import NamedTuple

from ..errors import UserError

MAGIC, VERSION = b"QIHC", 1
HELLO, WELCOME, REFUSED, START, COMMAND, MEASUREMENT, STOP, STOPPED = range(1, 9)

HEADER = struct.Struct("<4sBBHIIq")
START_BODY = struct.Struct("<dB")  # period [s], 1 for lockstep
COMMAND_BODY = struct.Struct("<IdB3f")  # measurement answered, voltage [V], amplifier, light
MEASUREMENT_BODY = struct.Struct(
    "<IqiiddB"
)  # command in force, tick, counts, current [A], tachometer [1/s], digital bits

_SIZES = {START: START_BODY.size, COMMAND: COMMAND_BODY.size, MEASUREMENT: MEASUREMENT_BODY.size}
_TEXTS = (REFUSED, STOP)
MOST_BYTES = 1024

DEFAULT_PORT = 18950

Address = tuple[str, int]


class Message(NamedTuple):
    """A message that came in whole."""

    kind: int
    session: int
    seq: int
    body: bytes


def packed(kind: int, session: int, seq: int, body: bytes = b"") -> bytes:
    """Return a message as bytes."""
    return HEADER.pack(MAGIC, VERSION, kind, len(body), session, seq, time.perf_counter_ns()) + body


def unpacked(data: bytes) -> Message | None:
    """Return the message that `data` holds; None where it is none of ours."""
    if len(data) < HEADER.size:
        return None
    magic, version, kind, size, session, seq, _ = HEADER.unpack_from(data)
    body = data[HEADER.size :]
    whole = len(body) == size and (kind in _TEXTS or size == _SIZES.get(kind, 0))
    if magic != MAGIC or version != VERSION or not HELLO <= kind <= STOPPED or not whole:
        return None
    return Message(kind, session, seq, body)


def beyond_loopback(address: Address) -> bool:
    """Whether who listens at `address` can be reached from other machines."""
    return not ipaddress.ip_address(address[0]).is_loopback


def address_of(text: str) -> Address:
    """Return (host, port) of `host:port` or `host`; raise UserError where it is neither."""
    host, colon, port = text.rpartition(":")
    if not colon:
        host, port = text, str(DEFAULT_PORT)
    if not _is_host(host) or not (port.isascii() and port.isdigit() and len(port) < 6 and int(port) < 65536):
        raise UserError(f"an address is host:port, as in 127.0.0.1:{DEFAULT_PORT}, found {text!r}")
    return host, int(port)


def _is_host(host: str) -> bool:
    try:
        return bool(host.encode("idna"))
    except UnicodeError:  # an empty or too long part between dots
        return False
