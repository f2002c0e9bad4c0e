"""The device's side of a simulated device in another process, over UDP: a board behind a socket."""

from __future__ import annotations

import math
import select
import socket
import time
from collections.abc import Callable

from ..errors import UserError
from ..fmu import FmuError
from .device import DeviceError
from .simulated import Board
from .udp_messages import (
    COMMAND,
    COMMAND_BODY,
    HELLO,
    MEASUREMENT,
    MEASUREMENT_BODY,
    MOST_BYTES,
    REFUSED,
    START,
    START_BODY,
    STOP,
    STOPPED,
    WELCOME,
    Address,
    Message,
    packed,
    unpacked,
)

SESSION_TIME = 1.0
"""A session that has been silent for this long [s] is over."""


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
