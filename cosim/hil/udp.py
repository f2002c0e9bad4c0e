"""A simulated device in another process, over UDP: the messages, the loop's side and the device's side.

Little-endian. Each message has a header: magic, version, kind, body's size, session, sequence number, time of sending [ns].
Of another session, sender, version or size it is dropped and counted; with a sequence number that is not new it is late or a
duplicate and never applied. Free-running, the device samples by its own clock and both sides take the newest message; in
lockstep one command is one period, and a message that got lost is sent again, so that the run is the same to the last bit as
with the device in the loop's process.
"""

from __future__ import annotations

import ipaddress
import math
import secrets
import select
import socket
import struct
import time
from collections.abc import Callable
from typing import NamedTuple

from ..errors import UserError
from ..fmu import FmuError
from .device import RETRIES, DeviceError, Led, LinkLostError, Sample, UnavailableError
from .simulated import Board

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

REPLY_TIME = 0.2
"""How long an answer may take [s] before the message is sent again."""
BEGINNINGS = 12
"""How often a message that begins a session is sent: nothing moves yet, and the device's computer may be busy."""
LOCKSTEP_TIME = 0.01
"""How long the answer to a command in lockstep may take [s] before the command is sent again."""
SESSION_TIME = 1.0
"""A session that has been silent for this long [s] is over."""
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


class UdpDevice:
    """The loop's side: a device that another process simulates."""

    def __init__(self, address: Address, *, real_time: bool = True) -> None:
        self.address, self.real_time = address, real_time
        self.name = f"simulated device at {address[0]}:{address[1]}"
        self.counters = {"foreign messages": 0, "late messages": 0, "messages sent again": 0}
        self._sample = Sample()
        self._socket: socket.socket | None = None
        self._session = 0
        self._sent, self._got = 0, 0  # sequence numbers
        self._first = False  # whether the sample of tick 0 waits to be read
        self._answered = True  # whether the last measurement has been answered (lockstep)
        self._command = b""
        self._enabled = False
        self._stopped = False

    def open(self) -> None:
        """Begin a session."""
        try:
            address = socket.getaddrinfo(*self.address, type=socket.SOCK_DGRAM)[0]
            self._socket = socket.socket(address[0], socket.SOCK_DGRAM)
            self._socket.connect(address[4])
        except OSError as error:
            raise UnavailableError(f"the address {self.address[0]}:{self.address[1]} cannot be used: {error}") from None
        self._socket.setblocking(False)
        self._session = secrets.randbits(32)
        self._exchange(HELLO, b"", WELCOME, BEGINNINGS)

    def start(self, period: float) -> None:
        """Let the device begin; its first sample is the answer."""
        message = self._exchange(START, START_BODY.pack(period, not self.real_time), MEASUREMENT, BEGINNINGS)
        self._take(message)
        self._first = True

    def read(self, timeout: float) -> Sample:
        """Return the newest sample that has come; in lockstep the one that answers the last command."""
        if self._first:
            self._first, self._answered = False, False
            return self._sample
        if not self.real_time and not self._answered:
            self._send_again()  # nothing was written since: the same once more, for one period
        until = time.monotonic() + timeout
        resend = time.monotonic() + LOCKSTEP_TIME
        while True:
            newest = self._newest()
            if newest is not None:
                self._take(newest)
                self._answered = False
                return self._sample
            now = time.monotonic()
            if now >= until:
                raise LinkLostError(f"nothing came from {self.name} for {timeout:g} s")
            if not self.real_time and now >= resend:
                self.counters["messages sent again"] += 1
                self._post(COMMAND, self._command, again=True)
                resend = now + LOCKSTEP_TIME
            self._wait(min(until, resend if not self.real_time else until) - now)

    def write(self, voltage: float, led: Led) -> None:
        """Send the voltage."""
        if self._stopped:
            raise DeviceError("the device has been stopped")
        self._command = COMMAND_BODY.pack(self._got, voltage, self._enabled, *led)
        self._post(COMMAND, self._command)
        self._answered = True

    def enable(self, on: bool) -> None:
        """Switch the amplifier with the next voltage."""
        self._enabled = on

    def safe_stop(self, reason: str) -> list[str]:
        """Tell the device to stop, until it says that it has; without an answer it cuts its voltage by itself."""
        self._enabled = False
        if self._socket is None or self._stopped:
            return []
        self._stopped = True
        try:
            self._exchange(STOP, reason.encode()[: MOST_BYTES - HEADER.size - 4], STOPPED)
        except DeviceError as error:
            return [f"{error}; it cuts its voltage by itself"]
        except UnavailableError as error:
            return [str(error)]
        return []

    def close(self) -> list[str]:
        """Close the socket."""
        if self._socket is not None:
            self._socket.close()
            self._socket = None
        return []

    def _exchange(self, kind: int, body: bytes, wanted: int, times: int = 1 + RETRIES) -> Message:
        """Send, at most so many times, until the wanted answer comes; raise UnavailableError or DeviceError without it."""
        assert self._socket is not None
        self._sent += 1
        for _ in range(times):
            try:
                self._post(kind, body, again=True)
                until = time.monotonic() + REPLY_TIME
                while (left := until - time.monotonic()) > 0:
                    self._wait(left)
                    message = self._received()
                    if message is not None and message.kind == wanted:
                        return message
            except ConnectionRefusedError:
                raise UnavailableError(
                    f"no device listens at {self.address[0]}:{self.address[1]}; start one with `qube-ihc device --listen "
                    f"{self.address[0]}:{self.address[1]}`"
                ) from None
        raise LinkLostError(f"{self.name} does not answer")

    def _post(self, kind: int, body: bytes, *, again: bool = False) -> None:
        assert self._socket is not None
        if not again:
            self._sent += 1
        try:
            self._socket.send(packed(kind, self._session, self._sent, body))
        except ConnectionRefusedError:
            if kind != COMMAND:  # an answer to an earlier message: a command that gets lost is noticed by reading
                raise
        except OSError as error:
            raise LinkLostError(f"nothing can be sent to {self.name}: {error}") from None

    def _send_again(self) -> None:
        self.counters["messages sent again"] += 1
        self._post(COMMAND, self._command or COMMAND_BODY.pack(self._got, 0.0, self._enabled, 0.0, 0.0, 0.0))

    def _wait(self, seconds: float) -> None:
        assert self._socket is not None
        select.select([self._socket], [], [], seconds)

    def _received(self) -> Message | None:
        """Return the next message of this session; None where there is none yet. Raises what the device refuses."""
        assert self._socket is not None
        while True:
            try:
                message = unpacked(self._socket.recv(MOST_BYTES))
            except BlockingIOError:
                return None
            except ConnectionRefusedError:
                if self._got:
                    raise LinkLostError(f"{self.name} is gone") from None
                raise
            if message is None or message.session != self._session:
                self.counters["foreign messages"] += 1
            elif message.kind == REFUSED:
                text = message.body.decode("utf-8", "replace")
                raise DeviceError(text) if self._got else UnavailableError(text)
            else:
                return message

    def _newest(self) -> Message | None:
        """Return the newest measurement among those that have come and are new."""
        newest = None
        while (message := self._received()) is not None:
            if message.kind != MEASUREMENT:
                continue
            answers = MEASUREMENT_BODY.unpack_from(message.body)[0]
            if message.seq <= self._got or (not self.real_time and answers != self._sent):
                self.counters["late messages"] += 1
                continue
            self._got, newest = message.seq, message
        return newest

    def _take(self, message: Message) -> None:
        s = self._sample
        self._got = message.seq
        _, s.tick, s.arm, s.pendulum, s.current, s.tachometer, s.digital = MEASUREMENT_BODY.unpack(message.body)
        s.due = 0 if self.real_time else time.perf_counter_ns()


class Server:
    """The device's side: a board behind a socket, for one session after the other."""

    def __init__(self, board: Board, address: Address, say: Callable[[str], None] = lambda _text: None) -> None:
        """Bind the address; raise UserError where it is taken."""
        self.board, self.say = board, say
        try:
            self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
            self.socket.bind(address)
        except OSError as error:
            raise UserError(f"cannot listen at {address[0]}:{address[1]}: {error.strerror}") from None
        self.socket.setblocking(False)
        self.address: Address = self.socket.getsockname()
        self.sessions = 0  # that are over
        self.foreign = 0
        self._peer: Address | None = None
        self._session: int | None = None
        self._ended: tuple[Address, int] | None = None  # the session before
        self._running = self._lockstep = False
        self._seen, self._applied, self._sent = 0, 0, 0  # sequence numbers: last one seen, last command, ours
        self._heard = 0.0
        self._next = 0  # when the next period ends [ns]
        self._last = b""

    def serve(self, over: Callable[[], bool]) -> None:
        """Serve until `over()`; then, as at the end of each session, the voltage is cut."""
        try:
            while not over():
                if self._running and not self._lockstep:
                    self._period()
                else:
                    select.select([self.socket], [], [], 0.05)
                    self._listen()
                if self._peer is not None and time.monotonic() - self._heard > SESSION_TIME:
                    self.board.cut_voltage("link lost")
                    self._end("the link is lost")
        finally:
            if self._peer is not None:
                self.board.safe_stop("the device's process ends")
                self._end("the device's process ends")
            self.socket.close()

    def _period(self) -> None:
        """Wait for the end of the period, take the newest command, let the period pass, send what is measured."""
        board = self.board
        ahead = self._next - time.perf_counter_ns()
        if ahead > 0:
            time.sleep(ahead * 1e-9)
        self._listen()
        if self._running:
            behind = max(0, (time.perf_counter_ns() - self._next) // self._period_ns)
            ticks = 1 + behind + board.late()
            self._next += ticks * self._period_ns
            self._advance(ticks, behind)

    def _advance(self, ticks: int, deaf: int = 0) -> None:
        try:
            self.board.tick(ticks, deaf)
            self._measure()
        except FmuError as error:
            self._refuse(str(error))

    def _measure(self) -> None:
        """Send the board's sample, unless a fault keeps it."""
        board, s = self.board, self.board.sample
        if board.silent():
            return
        try:
            board.refuse_to_read()
        except DeviceError as error:
            self._refuse(str(error))
            return
        body = MEASUREMENT_BODY.pack(self._applied, s.tick, s.arm, s.pendulum, s.current, s.tachometer, s.digital)
        self._sent += 1
        self._last = self._answer(MEASUREMENT, self._sent, body)

    def _listen(self) -> None:
        """Handle all messages that have come."""
        while True:
            try:
                data, peer = self.socket.recvfrom(MOST_BYTES)
            except BlockingIOError:
                return
            except ConnectionError:  # a peer that is gone, told by Windows
                continue
            message = unpacked(data)
            if message is not None and message.kind == STOP and (peer, message.session) == self._ended:
                self.socket.sendto(packed(STOPPED, message.session, 0), peer)  # which may have been lost
            elif message is None or (message.kind != HELLO and (peer, message.session) != (self._peer, self._session)):
                self.foreign += 1
            elif message.kind == HELLO:
                self._hello(message, peer)
            elif not self.board.silent():
                self._handle(message)

    def _hello(self, message: Message, peer: Address) -> None:
        if self._peer is not None and (peer, message.session) != (self._peer, self._session):
            text = f"the device is in use by {self._peer[0]}:{self._peer[1]}"
            self.socket.sendto(packed(REFUSED, message.session, 0, text.encode()), peer)
            return
        if self._peer is None:
            try:
                self.board.open()
            except FmuError as error:
                self.socket.sendto(packed(REFUSED, message.session, 0, str(error).encode()), peer)
                return
            self._peer, self._session, self._seen, self._applied, self._sent = peer, message.session, message.seq, 0, 0
            self.say(f"session with {peer[0]}:{peer[1]}")
        self._heard = time.monotonic()
        self._answer(WELCOME)

    def _handle(self, message: Message) -> None:
        self._heard = time.monotonic()
        new = message.seq > self._seen
        self._seen = max(self._seen, message.seq)
        if message.kind == START:
            if new:
                self._start(*START_BODY.unpack(message.body))
            elif self._last:
                self._send(self._last)
        elif message.kind == STOP:
            reason = message.body.decode("utf-8", "replace")
            if self._running:
                self.board.safe_stop(reason)
            self._answer(STOPPED)
            self._end(f"stopped: {reason}")
        elif message.kind == COMMAND and self._running:
            if new:
                self._command(message)
            elif self._lockstep:
                self._send(self._last)

    def _start(self, period: float, lockstep: int) -> None:
        if not (math.isfinite(period) and 1e-5 <= period <= 1.0):
            self._refuse(f"the period must lie in [1e-05, 1] s, found {period}")
            return
        self._lockstep, self._running = bool(lockstep), True
        self._period_ns = round(period * 1e9)
        self.board.start(period)
        self._next = time.perf_counter_ns() + self._period_ns
        self.say(f"running at {1 / period:g} Hz, {'lockstep' if lockstep else 'free-running'}")
        self._measure()

    def _command(self, message: Message) -> None:
        _, voltage, enabled, *led = COMMAND_BODY.unpack(message.body)
        try:
            self.board.command(voltage, enabled=bool(enabled), led=(led[0], led[1], led[2]))
        except DeviceError as error:
            self._refuse(str(error))
            return
        self._applied = message.seq
        if self._lockstep:
            self._advance(1 + self.board.late())

    def _refuse(self, text: str) -> None:
        self._answer(REFUSED, 0, text.encode())

    def _answer(self, kind: int, seq: int = 0, body: bytes = b"") -> bytes:
        """Send a message to the session's peer; return it."""
        assert self._session is not None
        data = packed(kind, self._session, seq, body)
        self._send(data)
        return data

    def _send(self, data: bytes) -> None:
        assert self._peer is not None
        try:
            self.socket.sendto(data, self._peer)
        except OSError:  # a peer that is gone; the session ends by its silence
            return

    def _end(self, why: str) -> None:
        self.say(why)
        self.board.close()
        if self._peer is not None and self._session is not None:
            self._ended = self._peer, self._session
        self._peer, self._session, self._running, self._last = None, None, False, b""
        self.sessions += 1
