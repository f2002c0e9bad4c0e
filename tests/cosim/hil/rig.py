"""What the tests of a run share: its parts from a scenario, a run in lockstep, a device with something between."""

import io
import threading
import time

from cosim.hil.faults import parse
from cosim.hil.loop import Loop
from cosim.hil.settings import Settings
from cosim.hil.simulated import Board, SimulatedDevice
from cosim.hil.udp_server import Server
from cosim.scenario import load_scenario
from cosim.scenario_system import build_system


def scenario_of(duration=1.0, step=1e-3, **changes):
    """Return (scenario, its folder); `plant__start__J_p=...` changes an entry."""
    scenario, folder = load_scenario("device")
    named = {name.replace("__", "."): value for name, value in changes.items()}
    return scenario.changed({"run.duration": duration, "run.step": step, **named}), folder


def parts(fmus, duration=1.0, step=1e-3, **changes):
    """Return the components (controller, plant)."""
    scenario, folder = scenario_of(duration, step, **changes)
    return build_system(scenario, fmus, folder).components


def board_of(fmus, faults="", **changes):
    return Board(parts(fmus, **changes)[1], parse(faults))


def lockstep(fmus, faults="", **changes):
    return SimulatedDevice(board_of(fmus, faults, **changes), real_time=False)


def settings_of(duration=1.0, rate=1000.0, **rest):
    """Return settings without start checks and real-time scheduling, unless they are asked for."""
    return Settings(
        **{"rate": rate, "duration": duration, "still": 0.0, "sign_test": False, "real_time": False, **rest}
    )


def loop_of(device, fmus, folder, duration=1.0, rate=1000.0, **rest):
    controller = parts(fmus, duration, 1.0 / rate)[0]
    return Loop(device, controller, settings_of(duration, rate, **rest), folder / "run")


def run(device, fmus, folder, duration=1.0, rate=1000.0, **rest):
    """Run to the end, return the report, and remove the log."""
    loop = loop_of(device, fmus, folder, duration, rate, **rest)
    try:
        return loop.run()
    finally:
        loop.log.discard()


class Between:
    """A device that passes everything on and notes the calls; `on_read(n, sample)` may change sample n or raise."""

    def __init__(self, device, on_read=None):
        self.device, self.on_read = device, on_read or (lambda n, sample: None)
        self.name, self.real_time, self.counters = device.name, device.real_time, device.counters
        self.calls, self.voltages, self.reads = [], [], 0

    def open(self):
        self.calls.append("open")
        self.device.open()

    def start(self, period):
        self.calls.append("start")
        self.device.start(period)

    def read(self, timeout):
        self.calls.append("read")
        sample = self.device.read(timeout)
        self.reads += 1
        self.on_read(self.reads - 1, sample)
        return sample

    def write(self, voltage, led):
        self.calls.append("write")
        self.voltages.append(voltage)
        self.device.write(voltage, led)

    def enable(self, on):
        self.calls.append("on" if on else "off")
        self.device.enable(on)

    def safe_stop(self, reason):
        self.calls.append("safe_stop")
        return self.device.safe_stop(reason)

    def close(self):
        self.calls.append("close")
        return self.device.close()


def at_rest(board):
    """Assert that the board's record ends at 0 V with the amplifier off, from the stop or its own cut on."""
    last = max(k for k, e in enumerate(board.record) if e.what.startswith(("stop", "cut:", "open")))
    assert all(event.voltage == 0.0 for event in board.record[last:])
    assert board.record[-1].voltage == 0.0
    assert not board._enabled


def one_sentence(error):
    """Assert that a message is one line that names something, and return it."""
    text = str(error)
    assert text
    assert len(io.StringIO(text).readlines()) == 1
    assert not text.endswith(".")
    assert ". " not in text
    return text


class Served:
    """A server in a thread."""

    def __init__(self, board):
        self.board, self.said, self.over, self.error = board, [], False, None
        self.server = Server(board, ("127.0.0.1", 0), self.said.append)
        self.address = self.server.address
        self.thread = threading.Thread(target=self._serve)
        self.thread.start()

    def _serve(self):
        try:
            self.server.serve(lambda: self.over)
        except BaseException as error:
            self.error = error

    def stop(self):
        self.over = True
        self.thread.join(timeout=20.0)
        assert not self.thread.is_alive()

    def wait(self, condition, seconds=10.0):
        until = time.monotonic() + seconds
        while not condition():
            assert time.monotonic() < until
            time.sleep(0.005)
