"""The loop's side of a simulated device in another process, over UDP."""

from __future__ import annotations

import secrets
import select
import socket
import time

from .device import RETRIES, DeviceError, Led, LinkLostError, Sample, UnavailableError
from .udp_messages import (
    COMMAND,
    COMMAND_BODY,
    HEADER,
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

REPLY_TIME = 0.2
"""How long an answer may take [s] before the message is sent again."""
BEGINNINGS = 12
"""How often a message that begins a session is sent: nothing moves yet, and the device's computer may be busy."""
LOCKSTEP_TIME = 0.01
"""How long the answer to a command in lockstep may take [s] before the command is sent again."""


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
