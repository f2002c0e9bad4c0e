"""The class HIL: converts arguments as cffi does, asks the board, raises HILError."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any

from cffi import FFI

from .. import stand_in
from ..board import DISCARD, HIGH, LED, NO_CHANGE, SYNCHRONIZED, TRISTATE, Board, Channels, LibraryError, Task
from .exceptions import HILError
from .types import Version

if stand_in.current.libhil_missing:
    raise OSError("cannot load library 'hil': libhil.so: cannot open shared object file: No such file or directory")

_ffi = FFI()
UINT32, INT32, BOOLEAN, DOUBLE = "uint32_t[]", "int32_t[]", "int8_t[]", "double[]"
READS = ((DOUBLE, -160), (INT32, -161), (BOOLEAN, -162), (DOUBLE, -163))
"""C type and the code of a missing buffer: analog, encoder, digital, other inputs."""
STRINGS = {0: "Quanser (stand-in)", 1: "QUBE-Servo 2", 2: "QUBE-Servo 2 USB", 3: "STAND-IN", 4: "0.0"}


def _integer(value: Any, kind: str = "uint32_t") -> int:
    """Return an integer argument as C gets it: TypeError for a float, OverflowError outside the type."""
    return int(_ffi.new(f"{kind} *", value)[0])


def _number(value: Any) -> float:
    return float(_ffi.new("double *", value)[0])


class _Memory:
    """An argument that is passed as memory: None, or any object with a contiguous buffer, whatever its dtype."""

    def __init__(self, kind: str, argument: Any) -> None:
        self.data = None if argument is None else _ffi.from_buffer(kind, argument)
        self.writable = argument is not None and not memoryview(argument).readonly

    def get(self, count: int, missing: int) -> list[Any]:
        """Return `count` values."""
        self._check(count, missing)
        return [] if self.data is None else [self.data[i] for i in range(count)]

    def put(self, values: Sequence[Any], missing: int) -> None:
        """Write the values to the front of the memory."""
        self._check(len(values), missing)
        if values and not self.writable:
            raise ValueError("a buffer for reading must be writable; the real package would overwrite constant memory")
        for i, value in enumerate(values):
            self.data[i] = value  # type: ignore[index]

    def _check(self, count: int, missing: int) -> None:
        if count and self.data is None:
            raise LibraryError(missing)
        if self.data is not None and len(self.data) < count:
            raise ValueError(
                f"a buffer must hold {count} elements of its C type, found room for {len(self.data)}; the real package "
                "would run over its end"
            )


class TaskHandle:
    """What task_create_reader returns; opaque."""

    def __init__(self, task: Task) -> None:
        self._task = task

    def __getitem__(self, index: int) -> Task:
        return self._task


class HIL:
    """A board of the vendor. Every call raises HILError with a negative code when the library refuses."""

    INFINITE = 0x7FFFFFFF

    def __init__(self, card_type: str | None = None, card_identifier: str = "0") -> None:
        self._card: Board | None = None
        if card_type is not None:
            self.open(card_type, card_identifier)

    # --- life

    def open(self, card_type: str, card_identifier: str = "0") -> None:
        """Open a board; one that this object has open is closed before."""
        self.close()
        kind, identifier = card_type.encode().decode(), card_identifier.encode().decode()
        with _library("open"):
            self._card = _open(kind, identifier)

    def close(self) -> None:
        """Close the board; the outputs stay as they are. Does nothing when nothing is open."""
        if self._card is None:
            return
        with self._board("close", io=False) as board:
            for task in board.tasks:
                board.stop(task)
                task.deleted = True
            board.tasks.clear()
            board.opened = False
            board.note("close", *board.outputs())
        self._card = None

    def is_valid(self) -> bool:
        """Whether a board is open; never raises."""
        stand_in.calls["is_valid"] += 1
        return self._card is not None

    @staticmethod
    def get_version() -> Version:
        """Return the version of the SDK."""
        return Version(12, 0, 0, 0, 0)

    def get_string_property(self, property_code: int, buffer_size: int) -> str:
        """Return a property of the board, such as its serial number."""
        code, size = _integer(property_code, "int32_t"), _integer(buffer_size, "uint64_t")
        with self._board("get_string_property", io=False):
            if code not in STRINGS:
                raise LibraryError(-681)
            return STRINGS[code][: max(size - 1, 0)]

    def set_card_specific_options(self, options: str, size: int) -> None:
        """Accept any options."""
        text, _ = options.encode().decode(), _integer(size, "uint64_t")
        with self._board("set_card_specific_options", io=False) as board:
            board.note("options", text)

    # --- set-up

    def set_encoder_counts(self, channels: Any, num_channels: int, counts: Any) -> None:
        """Make the encoders show these counts where they are."""
        memory, count, values = _Memory(UINT32, channels), _integer(num_channels), _Memory(INT32, counts)
        with self._board("set_encoder_counts") as board:
            pairs = dict(zip(memory.get(count, -124), values.get(count, -316), strict=True))
            Channels(encoder=list(pairs)).check()
            for channel, value in pairs.items():
                board.set_encoder(channel, value)
            board.note("counts", *([channel, value] for channel, value in pairs.items()))

    def set_digital_directions(
        self, input_channels: Any, num_input_channels: int, output_channels: Any, num_output_channels: int
    ) -> None:
        """Accept the directions that the board has anyway: DI0..2 and DO0."""
        inputs, count_in = _Memory(UINT32, input_channels), _integer(num_input_channels)
        outputs, count_out = _Memory(UINT32, output_channels), _integer(num_output_channels)
        with self._board("set_digital_directions") as board:
            chosen_in, chosen_out = inputs.get(count_in, -127), outputs.get(count_out, -139)
            Channels(digital=chosen_in).check()
            if not set(chosen_out) <= {0}:
                raise LibraryError(-139)
            board.note("directions", chosen_in, chosen_out)

    # --- immediate input

    def read_analog(self, channels: Any, num_channels: int, buffer: Any) -> None:
        """Read AI0, the motor current [A]."""
        self._read("read_analog", ((channels, num_channels, buffer), None, None, None))

    def read_encoder(self, channels: Any, num_channels: int, buffer: Any) -> None:
        """Read EI0 and EI1 [counts]."""
        self._read("read_encoder", (None, (channels, num_channels, buffer), None, None))

    def read_digital(self, channels: Any, num_channels: int, buffer: Any) -> None:
        """Read DI0 amplifier fault, DI1 stall detected, DI2 stall error."""
        self._read("read_digital", (None, None, (channels, num_channels, buffer), None))

    def read_other(self, channels: Any, num_channels: int, buffer: Any) -> None:
        """Read the tachometer, channel 14000 [counts/s]."""
        self._read("read_other", (None, None, None, (channels, num_channels, buffer)))

    def read(
        self,
        analog_channels: Any,
        num_analog_channels: int,
        encoder_channels: Any,
        num_encoder_channels: int,
        digital_channels: Any,
        num_digital_channels: int,
        other_channels: Any,
        num_other_channels: int,
        analog_buffer: Any,
        encoder_buffer: Any,
        digital_buffer: Any,
        other_buffer: Any,
    ) -> None:
        """Read groups of channels at the same time; None and 0 skip a group."""
        groups = (
            (analog_channels, num_analog_channels, analog_buffer),
            (encoder_channels, num_encoder_channels, encoder_buffer),
            (digital_channels, num_digital_channels, digital_buffer),
            (other_channels, num_other_channels, other_buffer),
        )
        self._read("read", groups)

    def _read(self, name: str, groups: Sequence[tuple[Any, Any, Any] | None]) -> None:
        filled = [group or (None, 0, None) for group in groups]
        memories = _memories([(channels, count) for channels, count, _ in filled])
        buffers = [_Memory(kind, group[2]) for (kind, _), group in zip(READS, filled, strict=True)]
        with self._board(name, io=stand_in.current.expired_refuses_reads) as board:
            channels = _channels(memories)
            board.pass_immediate_read()
            _deliver([board.read(channels)], buffers)

    # --- immediate output

    def write_analog(self, channels: Any, num_channels: int, buffer: Any) -> None:
        """Write AO0 [V]; the amplifier's range is +-15 V."""
        self._write("write_analog", (channels, num_channels, buffer), None, None, None)

    def write_digital(self, channels: Any, num_channels: int, buffer: Any) -> None:
        """Write DO0, the amplifier's enable."""
        self._write("write_digital", None, None, (channels, num_channels, buffer), None)

    def write_other(self, channels: Any, num_channels: int, buffer: Any) -> None:
        """Write the LED, channels 11000 to 11002, 0 to 1."""
        self._write("write_other", None, None, None, (channels, num_channels, buffer))

    def write(
        self,
        analog_channels: Any,
        num_analog_channels: int,
        pwm_channels: Any,
        num_pwm_channels: int,
        digital_channels: Any,
        num_digital_channels: int,
        other_channels: Any,
        num_other_channels: int,
        analog_buffer: Any,
        pwm_buffer: Any,
        digital_buffer: Any,
        other_buffer: Any,
    ) -> None:
        """Write groups of channels at the same time; None and 0 skip a group. The board has no PWM."""
        self._write(
            "write",
            (analog_channels, num_analog_channels, analog_buffer),
            (pwm_channels, num_pwm_channels, pwm_buffer),
            (digital_channels, num_digital_channels, digital_buffer),
            (other_channels, num_other_channels, other_buffer),
        )

    def _write(self, name: str, *groups: tuple[Any, Any, Any] | None) -> None:
        filled = [group or (None, 0, None) for group in groups]
        kinds = (DOUBLE, DOUBLE, BOOLEAN, DOUBLE)
        arguments = [
            (_Memory(UINT32, channels), _integer(count), _Memory(kind, buffer))
            for kind, (channels, count, buffer) in zip(kinds, filled, strict=True)
        ]
        codes = ((-133, -164), (-134, -165), (-139, -166), (-142, -167))
        with self._board(name) as board:
            analog, pwm, digital, other = (
                dict(zip(channels.get(count, code), buffer.get(count, missing), strict=True))
                for (channels, count, buffer), (code, missing) in zip(arguments, codes, strict=True)
            )
            if pwm:
                raise LibraryError(-134)
            board.write(analog, digital, other)

    # --- tasks

    def task_create_encoder_reader(self, samples_in_buffer: int, channels: Any, num_channels: int) -> TaskHandle:
        """Return a task that reads encoders into a ring buffer."""
        groups = ((None, 0), (channels, num_channels), (None, 0), (None, 0))
        return self._create("task_create_encoder_reader", samples_in_buffer, groups)

    def task_create_reader(
        self,
        samples_in_buffer: int,
        analog_channels: Any,
        num_analog_channels: int,
        encoder_channels: Any,
        num_encoder_channels: int,
        digital_channels: Any,
        num_digital_channels: int,
        other_channels: Any,
        num_other_channels: int,
    ) -> TaskHandle:
        """Return a task that reads groups of channels into a ring buffer; None and 0 skip a group."""
        groups = (
            (analog_channels, num_analog_channels),
            (encoder_channels, num_encoder_channels),
            (digital_channels, num_digital_channels),
            (other_channels, num_other_channels),
        )
        return self._create("task_create_reader", samples_in_buffer, groups)

    def _create(self, name: str, samples_in_buffer: Any, groups: Sequence[tuple[Any, Any]]) -> TaskHandle:
        room, memories = _integer(samples_in_buffer), _memories(groups)
        with self._board(name) as board:
            return TaskHandle(board.create(room, _channels(memories)))

    def task_set_buffer_overflow_mode(self, task: TaskHandle | None, mode: int) -> None:
        """Choose what happens when the ring buffer is full."""
        value = _integer(mode, "int32_t")
        with self._task("task_set_buffer_overflow_mode", task) as (board, real):
            if not 0 <= value <= (SYNCHRONIZED if board.virtual else DISCARD):
                raise LibraryError(-1080)
            real.mode = value

    def task_get_buffer_overflows(self, task: TaskHandle | None) -> int:
        """Return how many samples did not find room since the start."""
        with self._task("task_get_buffer_overflows", task) as (_, real):
            return real.overflows

    def task_start(self, task: TaskHandle | None, clock: int, frequency: float, num_samples: int) -> None:
        """Start sampling; HIL.INFINITE samples until task_stop."""
        number, hertz, samples = _integer(clock, "int32_t"), _number(frequency), _integer(num_samples)
        with self._task("task_start", task, io=True) as (board, real):
            board.start(real, number, hertz, samples)

    def task_flush(self, task: TaskHandle | None) -> None:
        """Do nothing: flushing is for writers."""
        with self._task("task_flush", task):
            pass

    def task_stop(self, task: TaskHandle | None) -> None:
        """Stop sampling; a waiting read returns."""
        with self._task("task_stop", task) as (board, real):
            board.stop(real)

    def task_delete(self, task: TaskHandle | None) -> None:
        """Stop the task and make its handle invalid."""
        with self._task("task_delete", task) as (board, real):
            board.stop(real)
            board.tasks.remove(real)
            real.deleted = True

    def task_stop_all(self) -> None:
        """Stop every task of the board."""
        with self._board("task_stop_all", io=False) as board:
            for task in board.tasks:
                board.stop(task)

    def task_delete_all(self) -> None:
        """Delete every task of the board."""
        with self._board("task_delete_all", io=False) as board:
            for task in board.tasks:
                board.stop(task)
                task.deleted = True
            board.tasks.clear()

    def task_read_encoder(self, task: TaskHandle | None, num_samples: int, buffer: Any) -> int:
        """Wait for samples of encoders; return their number, less (also 0) when the task has stopped."""
        return self._task_read("task_read_encoder", task, num_samples, (None, buffer, None, None))

    def task_read(
        self,
        task: TaskHandle | None,
        num_samples: int,
        analog_buffer: Any,
        encoder_buffer: Any,
        digital_buffer: Any,
        other_buffer: Any,
    ) -> int:
        """Wait for samples; return their number, less (also 0) when the task has stopped. Channels vary fastest."""
        buffers = (analog_buffer, encoder_buffer, digital_buffer, other_buffer)
        return self._task_read("task_read", task, num_samples, buffers)

    def _task_read(self, name: str, task: Any, num_samples: Any, buffers: Sequence[Any]) -> int:
        real = task[0] if task is not None else None
        n = _integer(num_samples)
        memory = [_Memory(kind, buffer) for (kind, _), buffer in zip(READS, buffers, strict=True)]
        with _library(name, self._card):
            valid, board = _valid_task(real), _valid(self._card)
            with board.lock:
                board.begin(stand_in.current.expired_refuses_reads)
            samples = board.read_samples(valid, n)
            _deliver(samples, memory)
            return len(samples)

    # --- watchdog

    def watchdog_set_analog_expiration_state(self, channels: Any, num_channels: int, voltages: Any) -> None:
        """Set what AO0 expires to [V]."""
        arguments = (_Memory(UINT32, channels), _integer(num_channels), _Memory(DOUBLE, voltages))
        with self._watchdog("watchdog_set_analog_expiration_state", -591) as board:
            states = _states(arguments, (0,), -133, -164)
            if stand_in.current.expire_to_zero_only and any(states.values()):
                raise LibraryError(-601)
            board.watchdog.analog = states.get(0, board.watchdog.analog)
            board.note("watchdog", "analog", states)

    def watchdog_set_digital_expiration_state(self, channels: Any, num_channels: int, states: Any) -> None:
        """Set what DO0 expires to: DigitalState values as int32."""
        arguments = (_Memory(UINT32, channels), _integer(num_channels), _Memory(INT32, states))
        with self._watchdog("watchdog_set_digital_expiration_state", -592) as board:
            expired = _states(arguments, (0,), -139, -166)
            for state in expired.values():
                if not 0 <= state <= NO_CHANGE:
                    raise LibraryError(-600)
                if state == TRISTATE:
                    raise LibraryError(-797)
                if stand_in.current.expire_to_zero_only and state == HIGH:
                    raise LibraryError(-1051)
                board.watchdog.digital = None if state == NO_CHANGE else state
            board.note("watchdog", "digital", expired)

    def watchdog_set_other_expiration_state(self, channels: Any, num_channels: int, states: Any) -> None:
        """Set what the LED expires to."""
        arguments = (_Memory(UINT32, channels), _integer(num_channels), _Memory(DOUBLE, states))
        with self._watchdog("watchdog_set_other_expiration_state", -594) as board:
            expired = _states(arguments, LED, -142, -167)
            if stand_in.current.expire_to_zero_only and any(expired.values()):
                raise LibraryError(-1053)
            board.watchdog.other.update(expired)
            board.note("watchdog", "other", expired)

    def watchdog_start(self, timeout: float) -> None:
        """Start the timer [s]."""
        seconds = _number(timeout)
        with self._watchdog("watchdog_start", -595) as board:
            board.start_watchdog(seconds)

    def watchdog_stop(self) -> None:
        """Stop the timer; an expiry stays until clear."""
        with self._watchdog("watchdog_stop", -596) as board:
            board.stop_watchdog()

    def watchdog_reload(self) -> bool:
        """Restart the time; False when it had expired."""
        with self._watchdog("watchdog_reload", -597) as board:
            return board.reload_watchdog()

    def watchdog_is_expired(self) -> bool:
        """Whether the watchdog has expired and not been cleared."""
        with self._watchdog("watchdog_is_expired", -598) as board:
            return board.watchdog.expired

    def watchdog_clear(self) -> None:
        """Allow access again after expiry."""
        with self._watchdog("watchdog_clear", -599) as board:
            board.clear_watchdog()

    # --- the way to the board

    @contextmanager
    def _board(self, name: str, io: bool = True) -> Iterator[Board]:
        with _library(name, self._card):
            board = _valid(self._card)
            with board.lock:
                board.begin(io)
                yield board

    @contextmanager
    def _watchdog(self, name: str, unsupported: int) -> Iterator[Board]:
        with self._board(name, io=False) as board:
            if not stand_in.current.watchdog:
                raise LibraryError(unsupported)
            yield board

    @contextmanager
    def _task(self, name: str, handle: Any, io: bool = False) -> Iterator[tuple[Board, Task]]:
        task = handle[0] if handle is not None else None
        with _library(name, self._card):
            valid, board = _valid_task(task), _valid(self._card)
            with board.lock:
                board.begin(io)
                yield board, valid


@contextmanager
def _library(name: str, board: Board | None = None) -> Iterator[None]:
    """Count a call, let it fail if that is planned, and turn a refusal into HILError."""
    try:
        code = stand_in.failure(name)
        if code:
            raise LibraryError(code)
        yield
    except LibraryError as refusal:
        stand_in.note(board.seconds if board else 0.0, "error", [name, refusal.code])
        raise HILError(refusal.code) from None


def _valid(board: Board | None) -> Board:
    if board is None or not board.opened:
        raise LibraryError(-88)
    return board


def _valid_task(task: Task | None) -> Task:
    if task is None or task.deleted:
        raise LibraryError(-105)
    return task


def _open(card_type: str, identifier: str) -> Board:
    setting = stand_in.current
    if card_type not in setting.card_types:
        raise LibraryError(-179)
    if not setting.driver:
        raise LibraryError(-107)
    if identifier not in setting.identifiers:
        raise LibraryError(-108)
    board = stand_in.boards.get(identifier)
    if setting.opened_elsewhere or (board and board.opened):
        raise LibraryError(setting.already_open)
    if board is None:
        board = stand_in.boards[identifier] = Board(virtual="@" in identifier)
    with board.lock:
        board.advance(board.now())
        if board.unplugged:
            raise LibraryError(-108)
        board.opened = True
        board.note("open", card_type, identifier)
    return board


def _memories(groups: Sequence[tuple[Any, Any]]) -> list[tuple[_Memory, int]]:
    return [(_Memory(UINT32, channels), _integer(count)) for channels, count in groups]


def _channels(memories: Sequence[tuple[_Memory, int]]) -> Channels:
    codes = (-121, -124, -127, -130)
    channels = Channels(*(memory.get(count, code) for (memory, count), code in zip(memories, codes, strict=True)))
    channels.check()
    return channels


def _deliver(samples: Sequence[Sequence[Sequence[Any]]], buffers: Sequence[_Memory]) -> None:
    for group, (buffer, (_, missing)) in enumerate(zip(buffers, READS, strict=True)):
        buffer.put([value for sample in samples for value in sample[group]], missing)


def _states(arguments: tuple[_Memory, int, _Memory], exist: Sequence[int], code: int, missing: int) -> dict[int, Any]:
    channels, count, values = arguments
    states = dict(zip(channels.get(count, code), values.get(count, missing), strict=True))
    if not set(states) <= set(exist):
        raise LibraryError(code)
    return states
