"""Whole runs over UDP: the same as in this process, with packets that get lost, and by the device's own clock.

Without faults, with all checks and for seconds they are in test_balance.py.
"""

import select
import socket
import threading
import time

import numpy as np
import pytest

from cosim.hil import loop as loop_module
from cosim.hil.device import LED_IDLE, VOLTAGE_CUT
from cosim.hil.simulated import HOLD
from cosim.hil.udp import UdpDevice
from tests.cosim.hil.rig import at_rest, lockstep, one_sentence, run

HOST = "127.0.0.1"
MS = 1e-3


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
                hit = self.seen % self.every == 0
                self.lost += hit
                times = 1 if not hit else 2 if self.double else 0
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
