"""The device in another process: its messages, the same run over the socket, packets that get lost, silence."""

import math
import select
import socket
import struct
import threading
import time

import numpy as np
import pytest

from cosim.errors import UserError
from cosim.hil import loop as loop_module
from cosim.hil import udp
from cosim.hil.device import LED_IDLE, VOLTAGE_CUT, DeviceError, LinkLostError, UnavailableError
from cosim.hil.simulated import HOLD
from cosim.hil.udp import Server, UdpDevice, address_of, packed, unpacked
from tests.cosim.hil.rig import at_rest, board_of, lockstep, one_sentence, run

HOST = "127.0.0.1"
MS = 1e-3
COMMAND = udp.COMMAND_BODY.pack(1, 2.5, True, 0.0, 0.0, 1.0)


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
        self.send(udp.HELLO, 1)
        assert self.receive().kind == udp.WELCOME
        self.send(udp.START, 2, udp.START_BODY.pack(period, lockstep))
        return self.measurement()

    def measurement(self):
        message = self.receive()
        assert message.kind == udp.MEASUREMENT
        return udp.MEASUREMENT_BODY.unpack(message.body)

    def end(self, seq=10**6):
        self.send(udp.STOP, seq, b"done")
        while self.receive().kind != udp.STOPPED:
            pass


# Messages


KINDS = {
    udp.HELLO: b"",
    udp.WELCOME: b"",
    udp.REFUSED: "ähm".encode(),
    udp.START: udp.START_BODY.pack(1e-3, 1),
    udp.COMMAND: COMMAND,
    udp.MEASUREMENT: udp.MEASUREMENT_BODY.pack(3, 4, -5, 6, 0.5, -7.0, 2),
    udp.STOP: b"reason",
    udp.STOPPED: b"",
}


@pytest.mark.parametrize("kind", KINDS)
def test_messages_come_back(kind):
    message = unpacked(packed(kind, 2**32 - 1, 2**32 - 1, KINDS[kind]))
    assert message == (kind, 2**32 - 1, 2**32 - 1, KINDS[kind])


def test_the_header_is_fixed_and_little_endian():
    before = time.perf_counter_ns()
    data = packed(udp.COMMAND, 0x01020304, 5, COMMAND)
    magic, version, kind, size, session, seq, sent = struct.unpack("<4sBBHIIq", data[:24])
    assert (magic, version, kind, size, session, seq) == (b"QIHC", 1, udp.COMMAND, len(COMMAND), 0x01020304, 5)
    assert before <= sent <= time.perf_counter_ns()
    assert len(data) == 24 + len(COMMAND)


@pytest.mark.parametrize("kind", KINDS)
def test_messages_of_another_size_are_none(kind):
    data = packed(kind, 1, 1, KINDS[kind])
    assert unpacked(data + b"x") is None
    assert unpacked(data[:-1]) is None
    if kind not in (udp.REFUSED, udp.STOP):
        assert unpacked(packed(kind, 1, 1, KINDS[kind] + b"x")) is None  # even where the header says so


@pytest.mark.parametrize("length", [0, 1, 23])
def test_less_than_a_header_is_none(length):
    assert unpacked(packed(udp.HELLO, 1, 1)[:length]) is None


@pytest.mark.parametrize(("at", "byte"), [(0, b"X"), (3, b"c"), (4, b"\x00"), (4, b"\x02"), (5, b"\x00"), (5, b"\x09")])
def test_another_magic_version_or_kind_is_none(at, byte):
    data = packed(udp.HELLO, 1, 1)
    assert unpacked(data) is not None
    assert unpacked(data[:at] + byte + data[at + 1 :]) is None


@pytest.mark.parametrize(
    ("text", "address"),
    [
        ("127.0.0.1:5", (HOST, 5)),
        ("bench", ("bench", udp.DEFAULT_PORT)),
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


# The device's side, message by message


def test_foreign_messages_are_dropped_and_counted(serve, client):
    served = serve()
    peer = client(served.address)
    peer.begin()
    good = packed(udp.COMMAND, 77, 3, COMMAND)
    for data in (b"", b"nonsense", good[:-1], b"X" + good[1:], good[:4] + b"\x02" + good[5:]):
        peer.raw(data)
    peer.send(udp.COMMAND, 3, COMMAND, session=78)
    assert peer.nothing()
    assert served.server.foreign == 6
    assert served.board.sample.tick == 0
    peer.end()


def test_a_session_is_its_peers_and_nobody_elses(serve, client):
    """Another address with the session's own number neither commands, nor locks the controller out, nor ends it."""
    served = serve()
    peer, thief = client(served.address), client(served.address)
    peer.begin()
    for kind, body in ((udp.COMMAND, COMMAND), (udp.START, udp.START_BODY.pack(MS, 1)), (udp.STOP, b"mine")):
        thief.send(kind, 2**32 - 1, body)
        assert thief.nothing()
    assert (served.server.foreign, served.server.sessions, served.board.sample.tick) == (3, 0, 0)
    thief.send(udp.HELLO, 1)
    assert b"in use" in thief.receive().body
    peer.send(udp.COMMAND, 3, COMMAND)
    assert peer.measurement()[:2] == (3, 1)
    peer.end(4)
    thief.send(udp.STOP, 5, b"mine")
    assert thief.nothing()
    peer.send(udp.STOP, 5, b"again")
    assert peer.receive().kind == udp.STOPPED


@pytest.mark.parametrize(
    ("host", "beyond"), [("127.0.0.1", False), ("127.8.8.8", False), ("0.0.0.0", True), ("192.168.1.2", True)]
)
def test_who_listens_beyond_this_machine_is_known(host, beyond):
    assert udp.beyond_loopback((host, 1)) is beyond


def test_session_numbers_cannot_be_guessed(serve, monkeypatch):
    monkeypatch.setattr(udp.secrets, "randbits", lambda bits: 2**bits - 5)
    device = UdpDevice(serve().address, real_time=False)
    device.open()
    assert device._session == 2**32 - 5
    device.safe_stop("done")
    device.close()


def test_a_command_is_applied_once_and_never_when_it_is_old(serve, client):
    served = serve()
    peer = client(served.address)
    assert peer.begin()[1] == 0
    peer.send(udp.COMMAND, 5, COMMAND)
    first = peer.measurement()
    assert first[:2] == (5, 1)
    for seq in (5, 5, 4, 2, 0):
        peer.send(udp.COMMAND, seq, udp.COMMAND_BODY.pack(1, -9.0, True, 0.0, 0.0, 0.0))
        assert peer.measurement() == first  # the last answer again
    assert served.board.record[-1].voltage == 2.5
    peer.send(udp.COMMAND, 9, COMMAND)
    assert peer.measurement()[:2] == (9, 2)
    peer.end()
    assert -9.0 not in [e.voltage for e in served.board.record]


def test_greeting_and_starting_twice_is_once(serve, client):
    served = serve()
    peer = client(served.address)
    first = peer.begin()
    peer.send(udp.HELLO, 1)
    assert peer.receive().kind == udp.WELCOME
    peer.send(udp.START, 2, udp.START_BODY.pack(MS, 1))
    assert peer.measurement() == first
    peer.end()
    assert [e.what for e in served.board.record].count("start") == 1


@pytest.mark.parametrize("period", [0.0, -1.0, 1e-9, 2.0, math.nan, math.inf])
def test_a_period_that_cannot_be_is_refused(serve, client, period):
    peer = client(serve().address)
    peer.send(udp.HELLO, 1)
    assert peer.receive().kind == udp.WELCOME
    peer.send(udp.START, 2, udp.START_BODY.pack(period, 1))
    message = peer.receive()
    assert message.kind == udp.REFUSED
    assert "period" in one_sentence(message.body.decode())
    peer.end()


@pytest.mark.parametrize("voltage", [math.nan, math.inf])
def test_a_voltage_that_is_not_finite_cuts_the_device(serve, client, voltage):
    peer = client(serve().address)
    peer.begin()
    peer.send(udp.COMMAND, 3, udp.COMMAND_BODY.pack(1, voltage, True, 0.0, 0.0, 0.0))
    assert peer.measurement()[-1] == VOLTAGE_CUT
    peer.end()


def test_a_stop_that_comes_twice_is_answered_or_ignored(serve, client):
    served = serve()
    peer = client(served.address)
    peer.begin()
    peer.end(3)
    peer.send(udp.STOP, 3, b"done")
    served.stop()
    error, served.error = served.error, None
    if error is not None:
        raise error


def test_a_client_that_wakes_after_its_session_is_over_does_not_end_the_server(serve, client, monkeypatch):
    monkeypatch.setattr(udp, "SESSION_TIME", 0.1)
    served = serve()
    peer = client(served.address)
    peer.begin()
    served.wait(lambda: served.server.sessions == 1)
    peer.send(udp.STOP, 3, b"late")
    time.sleep(0.2)
    served.stop()
    error, served.error = served.error, None
    if error is not None:
        raise error


def test_an_address_that_is_taken_is_a_user_error(serve, fmus):
    with pytest.raises(UserError, match="cannot listen") as caught:
        Server(board_of(fmus), serve().address)
    one_sentence(caught.value)


# The loop's side, message by message


@pytest.fixture
def scripted():
    """Make a device of the loop that talks to a socket of the test."""
    made = []

    def make(*, real_time=False):
        mine = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        mine.bind((HOST, 0))
        mine.settimeout(5.0)
        device = UdpDevice(mine.getsockname(), real_time=real_time)
        answers = {udp.HELLO: (udp.WELCOME, b""), udp.START: (udp.MEASUREMENT, measured(0, 0))}

        def answer():
            for _ in answers:
                data, peer = mine.recvfrom(2048)
                message = unpacked(data)
                assert message is not None
                kind, body = answers[message.kind]
                mine.sendto(packed(kind, message.session, 1, body), peer)

        thread = threading.Thread(target=answer)
        thread.start()
        device.open()
        device.start(MS)
        thread.join()
        made.append((device, mine))
        assert device.read(1.0).tick == 0

        def send(seq, body, session=None, kind=udp.MEASUREMENT):
            data = packed(kind, device._session if session is None else session, seq, body)
            assert device._socket is not None
            mine.sendto(data, device._socket.getsockname())

        return device, mine, send

    yield make
    for device, mine in made:
        device.close()
        mine.close()


def measured(answers, tick, arm=0):
    return udp.MEASUREMENT_BODY.pack(answers, tick, arm, 0, 0.0, 0.0, 0)


def test_the_newest_measurement_is_taken_and_the_gap_is_seen(scripted):
    device, _, send = scripted(real_time=True)
    for seq, tick in ((2, 1), (3, 2), (5, 4)):
        send(seq, measured(0, tick, 10 * tick))
    time.sleep(0.05)
    sample = device.read(1.0)
    assert (sample.tick, sample.arm, sample.due) == (4, 40, 0)


def test_old_foreign_and_doubled_measurements_are_dropped_and_counted(scripted):
    device, mine, send = scripted(real_time=True)
    send(5, measured(0, 4))
    assert device.read(1.0).tick == 4
    send(5, measured(0, 99))
    send(3, measured(0, 98))
    send(6, measured(0, 97), session=device._session ^ 1)
    mine.sendto(b"nonsense", device._socket.getsockname())
    send(7, b"", kind=udp.WELCOME)
    send(6, measured(0, 5))
    time.sleep(0.05)
    assert device.read(1.0).tick == 5
    assert device.counters["late messages"] == 2
    assert device.counters["foreign messages"] == 2


def test_in_lockstep_only_the_answer_to_the_last_command_counts(scripted):
    device, _, send = scripted()
    device.write(1.0, LED_IDLE)
    sent = device._sent
    send(2, measured(sent - 1, 50))
    send(3, measured(sent, 1))
    assert device.read(1.0).tick == 1
    assert device.counters["late messages"] == 1


def test_in_lockstep_a_command_is_sent_again_until_it_is_answered(scripted):
    device, mine, send = scripted()
    device.write(1.0, LED_IDLE)
    seen = []

    def answer():
        for _ in range(3):
            seen.append(unpacked(mine.recv(2048)))
        send(2, measured(seen[0].seq, 1))

    thread = threading.Thread(target=answer)
    thread.start()
    assert device.read(3.0).tick == 1
    thread.join()
    assert len({(m.seq, m.body) for m in seen}) == 1


def test_commands_sent_again_are_counted(scripted):
    device, _, send = scripted()
    device.write(1.0, LED_IDLE)
    threading.Timer(0.2, lambda: send(2, measured(device._sent, 1))).start()
    assert device.read(3.0).tick == 1
    assert device.counters["messages sent again"] > 0


@pytest.mark.parametrize("real_time", [True, False])
def test_silence_is_a_lost_link(scripted, real_time):
    device, _, _ = scripted(real_time=real_time)
    device.write(1.0, LED_IDLE)
    before = time.monotonic()
    with pytest.raises(LinkLostError) as caught:
        device.read(0.12)
    assert time.monotonic() - before >= 0.12
    one_sentence(caught.value)


def test_a_refusal_is_an_error_with_its_text(scripted):
    device, _, send = scripted()
    device.write(1.0, LED_IDLE)
    send(0, b"the coffee is out", kind=udp.REFUSED)
    with pytest.raises(DeviceError, match="the coffee is out"):
        device.read(1.0)


def test_writing_after_the_stop_is_refused_and_stopping_again_is_nothing(serve):
    device = UdpDevice(serve().address, real_time=False)
    assert device.safe_stop("before") == []
    device.close()
    device.open()
    device.start(MS)
    device.read(1.0)
    assert device.safe_stop("enough") == []
    assert device.safe_stop("again") == []
    with pytest.raises(DeviceError):
        device.write(1.0, LED_IDLE)
    device.close()
    device.close()
    assert device.safe_stop("closed") == []


# Whole runs


def compare(a, b):
    assert a.reason == b.reason
    assert a.stop == b.stop
    assert a.result.time.tobytes() == b.result.time.tobytes()
    names = [n for n in a.result.signals if n.startswith(("controller.", "plant."))]
    for name in [*names, "hil.applied_voltage", "hil.missed", "hil.steps", "hil.digital", "hil.tachometer"]:
        assert a.result[name].tobytes() == b.result[name].tobytes(), name


@pytest.mark.parametrize(
    ("faults", "duration"),
    [
        ("", 6.0),
        ("arm-jump@0.2=500,late@0.3=3,push@0.4=0.005:0.05", 0.6),
        ("late@0.2=30", 0.4),
        ("amplifier-fault@0.2", 0.4),
        ("current@0.2=nan", 0.4),
        ("pendulum-jump@0.1=300:0.01", 0.4),
        ("stall@0.1,late@0.1=2,late@0.2=4", 0.4),
    ],
)
def test_a_run_in_lockstep_is_the_one_in_this_process_to_the_last_bit(serve, fmus, tmp_path, patient, faults, duration):
    served = serve(faults)
    here = lockstep(fmus, faults)
    options = {"still": 0.02, "sign_test": False}
    one = run(UdpDevice(served.address, real_time=False), fmus, tmp_path, duration, **options)
    other = run(here, fmus, tmp_path, duration, **options)
    compare(one, other)
    assert one.failures == ()
    served.wait(lambda: served.server.sessions == 1)
    told = [(e.time, e.what, e.voltage) for e in served.board.record]
    assert told == [(e.time, e.what, e.voltage) for e in here.board.record]


def test_a_run_with_its_sign_test_is_the_same_too(serve, fmus, tmp_path, patient):
    served = serve()
    options = {"still": 0.05, "sign_test": True}
    one = run(UdpDevice(served.address, real_time=False), fmus, tmp_path, 0.2, **options)
    compare(one, run(lockstep(fmus), fmus, tmp_path, 0.2, **options))
    assert one.stop == "complete"


@pytest.mark.parametrize(
    ("faults", "said"),
    [
        ("read-error@0.1", "could not be read"),
        ("write-error@0.1", "refused the voltage"),
        ("push@0.1=1e300", "doStep"),
        ("silent@0.1", "nothing came"),
    ],
)
def test_faults_that_end_the_link_end_the_run(serve, fmus, tmp_path, monkeypatch, faults, said):
    monkeypatch.setattr(loop_module, "READ_TIMEOUT", 0.5)
    served = serve(faults)
    report = run(UdpDevice(served.address, real_time=False), fmus, tmp_path, 0.4)
    assert report.stop == "fault"
    assert said in one_sentence(report.reason)
    served.wait(lambda: served.server.sessions == 1)


def test_two_runs_one_after_the_other_are_the_same(serve, fmus, tmp_path, patient):
    served = serve()
    one, two = (run(UdpDevice(served.address, real_time=False), fmus, tmp_path, 0.3) for _ in range(2))
    compare(one, two)
    assert one.stop == "complete"


class Relay:
    """Passes packets on in both directions, and loses each n-th of all, or doubles it."""

    def __init__(self, target, every, *, double=False):
        self.every, self.double, self.seen, self.lost, self.over = every, double, 0, 0, False
        self.front = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.front.bind((HOST, 0))
        self.back = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.back.connect(target)
        self.address = self.front.getsockname()
        self.thread = threading.Thread(target=self._pass)
        self.thread.start()

    def _pass(self):
        peer = None
        while not self.over:
            for ready in select.select([self.front, self.back], [], [], 0.05)[0]:
                if ready is self.front:
                    data, peer = self.front.recvfrom(2048)
                    send = self.back.send
                else:
                    data = self.back.recv(2048)
                    send = self._to(peer)
                self.seen += 1
                chosen = self.seen % self.every == 0
                self.lost += chosen
                times = 1 if not chosen else 2 if self.double else 0
                for _ in range(times):
                    send(data)

    def _to(self, peer):
        return lambda data: self.front.sendto(data, peer)

    def stop(self):
        self.over = True
        self.thread.join(timeout=20.0)
        self.front.close()
        self.back.close()


@pytest.fixture
def relay():
    relays = []

    def make(*args, **options):
        relays.append(Relay(*args, **options))
        return relays[-1]

    yield make
    for one in relays:
        one.stop()


def test_lost_packets_leave_the_run_the_same_to_the_last_bit(serve, fmus, tmp_path, patient, relay):
    faults = "arm-jump@0.03=500,late@0.05=2"
    served = serve(faults)
    lossy = relay(served.address, 7)
    one = run(UdpDevice(lossy.address, real_time=False), fmus, tmp_path, 0.1)
    compare(one, run(lockstep(fmus, faults), fmus, tmp_path, 0.1))
    assert one.stop == "complete"
    assert lossy.lost > 30


def test_doubled_packets_leave_the_run_the_same_to_the_last_bit(serve, fmus, tmp_path, patient, relay):
    served = serve()
    one = run(UdpDevice(relay(served.address, 1, double=True).address, real_time=False), fmus, tmp_path, 0.2)
    compare(one, run(lockstep(fmus), fmus, tmp_path, 0.2))
    assert one.stop == "complete"
    served.stop()
    served.error = None  # a doubled STOP ends the server, see above


# Who may use it


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


def test_nobody_listening_is_told_with_the_command_to_start(fmus, tmp_path):
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as free:
        free.bind((HOST, 0))
        port = free.getsockname()[1]
    device = UdpDevice((HOST, port))
    with pytest.raises(UnavailableError) as caught:
        run(device, fmus, tmp_path)
    assert f"qube-ihc device --listen {HOST}:{port}" in one_sentence(caught.value)
    assert not list(tmp_path.iterdir())


def test_somebody_else_listening_does_not_answer():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other:
        other.bind((HOST, 0))
        device = UdpDevice(other.getsockname())
        with pytest.raises(DeviceError, match="does not answer") as caught:
            device.open()
        one_sentence(caught.value)
        device.close()


def test_an_address_that_cannot_be_is_unavailable():
    with pytest.raises(UnavailableError) as caught:
        UdpDevice(("no such host.invalid", 5)).open()
    one_sentence(caught.value)


def test_a_device_that_is_gone_is_a_lost_link(serve, fmus, tmp_path, monkeypatch):
    monkeypatch.setattr(loop_module, "READ_TIMEOUT", 0.5)
    served = serve()
    device = UdpDevice(served.address, real_time=False)
    read, reads = device.read, []

    def leave(timeout):
        reads.append(0)
        if len(reads) == 100:
            served.stop()
        return read(timeout)

    device.read = leave
    report = run(device, fmus, tmp_path, 0.4)
    assert report.stop == "fault"
    one_sentence(report.reason)
    assert len(report.failures) == 1
    assert served.board.record[-2].what == "stop: the device's process ends"


# Its own clock


def moving(served):
    """Begin a session that runs by the device's clock and has a voltage; return the device."""
    for _ in range(20):
        device = UdpDevice(served.address)
        device.open()
        device.enable(True)
        device.start(2 * MS)
        device.write(0.5, LED_IDLE)
        for _ in range(25):
            sample = device.read(5.0)
            if served.board.record[-1].voltage == 0.5:
                return device
            device.write(0.5, LED_IDLE)
            if sample.digital:
                break
        device.safe_stop("too slow a machine: once more")  # a stall beyond the hold time
        device.close()
    pytest.skip("this machine stalls for longer than the hold time each time")
    return None


def test_a_client_that_falls_silent_is_cut_within_the_hold_time_and_another_can_come(serve, fmus, tmp_path, patient):
    served = serve()
    device = moving(served)
    last_voltage = served.board.record[-1]
    device.close()  # without a stop, as a process that was killed
    served.wait(lambda: served.board.record[-1].voltage == 0.0)
    cut = next(e for e in served.board.record if e.what == "cut: nothing heard" and e.time >= last_voltage.time)
    # commands after the first kept the voltage; nothing came for longer than the board needs to pass the hold time
    assert cut.time - last_voltage.time <= HOLD + 26 * 2 * MS + 2 * MS
    served.wait(lambda: served.server._peer is None)
    assert "the link is lost" in served.said
    at_rest(served.board)
    again = run(UdpDevice(served.address, real_time=False), fmus, tmp_path, 0.3)
    compare(again, run(lockstep(fmus), fmus, tmp_path, 0.3))
    assert again.stop == "complete"


def test_the_cut_is_seen_by_who_only_listens(serve):
    served = serve()
    device = moving(served)
    sample = device.read(5.0)
    for _ in range(200):
        if sample.digital:
            break
        sample = device.read(5.0)
    assert sample.digital == VOLTAGE_CUT
    device.write(5.0, LED_IDLE)
    assert device.read(5.0).digital == VOLTAGE_CUT
    assert device.safe_stop("done") == []
    device.close()
    assert 5.0 not in [e.voltage for e in served.board.record]


def test_its_clock_goes_on_without_commands(serve):
    served = serve()
    device = UdpDevice(served.address)
    device.open()
    device.start(2 * MS)
    before = time.perf_counter()
    ticks = [device.read(5.0).tick for _ in range(30)]
    passed = time.perf_counter() - before
    assert np.all(np.diff(ticks) >= 1)
    assert ticks[-1] * 2 * MS <= passed + 0.1
    device.safe_stop("done")
    device.close()


def test_a_run_by_its_clock_ends_at_0_V(serve, fmus, tmp_path):
    served = serve()
    report = run(UdpDevice(served.address), fmus, tmp_path, 0.3, 500.0, stop_on_misses=False)
    assert report.stop in ("complete", "fault")  # a stall of the machine beyond the hold time is a fault
    assert report.failures == ()
    assert len(report.result.time) > 1
    if report.stop == "complete":
        assert report.result.time[-1] >= 0.3
    served.wait(lambda: served.server.sessions == 1)
    at_rest(served.board)


def test_a_silent_device_can_be_opened_again(serve, monkeypatch):
    monkeypatch.setattr(udp, "SESSION_TIME", 0.2)
    monkeypatch.setattr(udp, "REPLY_TIME", 0.05)
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
