"""The device's side over UDP, message by message: who is heard, what is applied, and what silence leads to."""

import math
import select
import socket
import time

import pytest

from cosim.errors import UserError
from cosim.hil import udp_messages as messages
from cosim.hil import udp_server
from cosim.hil.device import LED_IDLE, VOLTAGE_CUT, LinkLostError, UnavailableError
from cosim.hil.udp import UdpDevice
from cosim.hil.udp_messages import packed, unpacked
from cosim.hil.udp_server import Server
from tests.cosim.hil.rig import board_of, one_sentence

MS = 1e-3
COMMAND = messages.COMMAND_BODY.pack(1, 2.5, True, 0.0, 0.0, 1.0)


@pytest.fixture
def client():
    """Make a plain socket that speaks the protocol by hand."""
    sockets = []

    def make(address, session=77):
        peer = Peer(address, session)
        sockets.append(peer.socket)
        return peer

    yield make
    for one in sockets:
        one.close()


class Peer:
    def __init__(self, address, session):
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.connect(address)
        self.session = session

    def send(self, kind, seq, body=b"", session=None):
        self.raw(packed(kind, self.session if session is None else session, seq, body))

    def raw(self, data):
        self.socket.send(data)

    def receive(self, timeout=5.0):
        self.socket.settimeout(timeout)
        message = unpacked(self.socket.recv(2048))
        assert message is not None
        return message

    def nothing(self, timeout=0.15):
        return not select.select([self.socket], [], [], timeout)[0]

    def begin(self, period=MS, *, lockstep=True):
        """Open and start a session; return the first measurement."""
        self.send(messages.HELLO, 1)
        assert self.receive().kind == messages.WELCOME
        self.send(messages.START, 2, messages.START_BODY.pack(period, lockstep))
        return self.measurement()

    def measurement(self):
        message = self.receive()
        assert message.kind == messages.MEASUREMENT
        return messages.MEASUREMENT_BODY.unpack(message.body)

    def end(self, seq=10**6):
        self.send(messages.STOP, seq, b"done")
        while self.receive().kind != messages.STOPPED:
            pass


def test_foreign_messages_are_dropped_and_counted(serve, client):
    served = serve()
    peer = client(served.address)
    peer.begin()
    good = packed(messages.COMMAND, 77, 3, COMMAND)
    for data in (b"", b"nonsense", good[:-1], b"X" + good[1:], good[:4] + b"\x02" + good[5:]):
        peer.raw(data)
    peer.send(messages.COMMAND, 3, COMMAND, session=78)
    assert peer.nothing()
    assert served.server.foreign == 6
    assert served.board.sample.tick == 0
    peer.end()


def test_a_session_is_its_peers_and_nobody_elses(serve, client):
    """Another address with the session's own number neither commands, nor locks the controller out, nor ends it."""
    served = serve()
    peer, thief = client(served.address), client(served.address)
    peer.begin()
    for kind, body in (
        (messages.COMMAND, COMMAND),
        (messages.START, messages.START_BODY.pack(MS, 1)),
        (messages.STOP, b"mine"),
    ):
        thief.send(kind, 2**32 - 1, body)
        assert thief.nothing()
    assert (served.server.foreign, served.server.sessions, served.board.sample.tick) == (3, 0, 0)
    thief.send(messages.HELLO, 1)
    assert b"in use" in thief.receive().body
    peer.send(messages.COMMAND, 3, COMMAND)
    assert peer.measurement()[:2] == (3, 1)
    peer.end(4)
    thief.send(messages.STOP, 5, b"mine")
    assert thief.nothing()
    peer.send(messages.STOP, 5, b"again")
    assert peer.receive().kind == messages.STOPPED


def test_a_command_is_applied_once_and_never_when_it_is_old(serve, client):
    served = serve()
    peer = client(served.address)
    assert peer.begin()[1] == 0
    peer.send(messages.COMMAND, 5, COMMAND)
    first = peer.measurement()
    assert first[:2] == (5, 1)
    for seq in (5, 5, 4, 2, 0):
        peer.send(messages.COMMAND, seq, messages.COMMAND_BODY.pack(1, -9.0, True, 0.0, 0.0, 0.0))
        assert peer.measurement() == first  # the last answer again
    assert served.board.record[-1].voltage == 2.5
    peer.send(messages.COMMAND, 9, COMMAND)
    assert peer.measurement()[:2] == (9, 2)
    peer.end()
    assert -9.0 not in [e.voltage for e in served.board.record]


def test_greeting_and_starting_twice_is_once(serve, client):
    served = serve()
    peer = client(served.address)
    first = peer.begin()
    peer.send(messages.HELLO, 1)
    assert peer.receive().kind == messages.WELCOME
    peer.send(messages.START, 2, messages.START_BODY.pack(MS, 1))
    assert peer.measurement() == first
    peer.end()
    assert [e.what for e in served.board.record].count("start") == 1


@pytest.mark.parametrize("period", [0.0, -1.0, 1e-9, 2.0, math.nan, math.inf])
def test_a_period_that_cannot_be_is_refused(serve, client, period):
    peer = client(serve().address)
    peer.send(messages.HELLO, 1)
    assert peer.receive().kind == messages.WELCOME
    peer.send(messages.START, 2, messages.START_BODY.pack(period, 1))
    message = peer.receive()
    assert message.kind == messages.REFUSED
    assert "period" in one_sentence(message.body.decode())
    peer.end()


@pytest.mark.parametrize("voltage", [math.nan, math.inf])
def test_a_voltage_that_is_not_finite_cuts_the_device(serve, client, voltage):
    peer = client(serve().address)
    peer.begin()
    peer.send(messages.COMMAND, 3, messages.COMMAND_BODY.pack(1, voltage, True, 0.0, 0.0, 0.0))
    assert peer.measurement()[-1] == VOLTAGE_CUT
    peer.end()


def test_a_stop_that_comes_twice_is_answered_or_ignored(serve, client):
    served = serve()
    peer = client(served.address)
    peer.begin()
    peer.end(3)
    peer.send(messages.STOP, 3, b"done")
    served.stop()
    error, served.error = served.error, None
    if error is not None:
        raise error


def test_a_client_that_wakes_after_its_session_is_over_does_not_end_the_server(serve, client, monkeypatch):
    monkeypatch.setattr(udp_server, "SESSION_TIME", 0.1)
    served = serve()
    peer = client(served.address)
    peer.begin()
    served.wait(lambda: served.server.sessions == 1)
    peer.send(messages.STOP, 3, b"late")
    time.sleep(0.2)
    served.stop()
    error, served.error = served.error, None
    if error is not None:
        raise error


def test_an_address_that_is_taken_is_a_user_error(serve, fmus):
    with pytest.raises(UserError, match="cannot listen") as caught:
        Server(board_of(fmus), serve().address)
    one_sentence(caught.value)


def test_a_device_in_use_refuses_a_second_client(serve):
    served = serve()
    first = UdpDevice(served.address, real_time=False)
    first.open()
    first.start(MS)
    first.read(1.0)
    second = UdpDevice(served.address, real_time=False)
    with pytest.raises(UnavailableError, match="in use by 127") as caught:
        second.open()
    one_sentence(caught.value)
    assert second.safe_stop("not mine") != []  # told, as it has no session
    second.close()
    first.write(1.0, LED_IDLE)
    assert first.read(1.0).tick == 1
    assert first.safe_stop("done") == []
    first.close()
    third = UdpDevice(served.address, real_time=False)
    third.open()
    third.safe_stop("done")
    third.close()


def test_a_silent_device_can_be_opened_again(serve, monkeypatch):
    monkeypatch.setattr(udp_server, "SESSION_TIME", 0.2)
    served = serve("silent@0.01")
    for _ in range(2):
        device = UdpDevice(served.address, real_time=False)
        device.open()
        device.start(MS)
        sessions = served.server.sessions
        for _ in range(10):
            device.read(0.5)
            device.write(0.0, LED_IDLE)
        with pytest.raises(LinkLostError):
            device.read(0.1)
        device.close()
        served.wait(lambda before=sessions: served.server.sessions > before)
