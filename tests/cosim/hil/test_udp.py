"""The loop's side over UDP, message by message, and devices that are not there."""

import socket
import threading
import time

import pytest

from cosim.hil import udp
from cosim.hil import udp_messages as messages
from cosim.hil.device import LED_IDLE, DeviceError, LinkLostError, UnavailableError
from cosim.hil.udp import UdpDevice
from cosim.hil.udp_messages import packed, unpacked
from tests.cosim.hil.rig import one_sentence, run

HOST = "127.0.0.1"
MS = 1e-3


def test_session_numbers_cannot_be_guessed(serve, monkeypatch):
    monkeypatch.setattr(udp.secrets, "randbits", lambda bits: 2**bits - 5)
    device = UdpDevice(serve().address, real_time=False)
    device.open()
    assert device._session == 2**32 - 5
    device.safe_stop("done")
    device.close()


@pytest.fixture
def scripted():
    """Make a device of the loop that talks to a socket of the test."""
    made = []

    def make(*, real_time=False):
        mine = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        mine.bind((HOST, 0))
        mine.settimeout(5.0)
        device = UdpDevice(mine.getsockname(), real_time=real_time)
        answers = {messages.HELLO: (messages.WELCOME, b""), messages.START: (messages.MEASUREMENT, measured(0, 0))}

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

        def send(seq, body, session=None, kind=messages.MEASUREMENT):
            data = packed(kind, device._session if session is None else session, seq, body)
            assert device._socket is not None
            mine.sendto(data, device._socket.getsockname())

        return device, mine, send

    yield make
    for device, mine in made:
        device.close()
        mine.close()


def measured(answers, tick, arm=0):
    return messages.MEASUREMENT_BODY.pack(answers, tick, arm, 0, 0.0, 0.0, 0)


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
    send(7, b"", kind=messages.WELCOME)
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
    send(0, b"the coffee is out", kind=messages.REFUSED)
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


def test_nobody_listening_is_told_with_the_command_to_start(fmus, tmp_path):
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as free:
        free.bind((HOST, 0))
        port = free.getsockname()[1]
    device = UdpDevice((HOST, port))
    with pytest.raises(UnavailableError) as caught:
        run(device, fmus, tmp_path)
    assert f"qube-ihc device --listen {HOST}:{port}" in one_sentence(caught.value)
    assert not list(tmp_path.iterdir())


def test_somebody_else_listening_does_not_answer(monkeypatch):
    monkeypatch.setattr(udp, "REPLY_TIME", 0.01)
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
