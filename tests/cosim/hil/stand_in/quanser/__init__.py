"""A stand-in for the vendor's Python package `quanser`, written from its published behaviour; it shares no code with it.

A driver for the QUBE-Servo 2 runs on it unmodified. What the board is to do is set in `quanser.stand_in`, which the real
package does not have. Marks: [C] seen in the vendor's sources or published documentation, [I] inferred, [U] unknown.

[C] Names, argument names, order and types of every call here; each call converts its arguments (cffi), calls the library and
    raises HILError(code) for a negative result; `open` closes what the object had open; `close` does nothing when nothing
    is open; the identifier defaults to "0" and INFINITE is 0x7fffffff (newer releases; older ones have neither).
[C] Buffers are passed as memory: a list or a plain number raises TypeError, memory that is not contiguous ValueError, a
    wrong dtype is read byte by byte. A NumPy scalar and array.array are accepted. t_boolean has 1 byte, t_digital_state 4:
    the states of watchdog_set_digital_expiration_state are int32, not int8 as for write_digital.
[C] Tasks: at least 1 sample in the buffer (-320), at least 1 sample read (-321), not more than the buffer holds (-159);
    task_read returns fewer samples, also 0, when the task has stopped; default mode: the next read raises -111; OVERWRITE
    loses the oldest, DISCARD the newest samples; WAIT and SYNCHRONIZED are for simulated cards; task_flush does nothing
    to a reader; deleting stops; a stopped task may be started again.
[C] Watchdog: reload returns False after expiry and does not clear; stop does not clear either; I/O is refused until clear.
[C] Error codes by name: -88 card handle, -105 task handle, -107 driver, -108 no board, -111 overflow, channels -121 ...
    -142, clock -144, -145, -149, -150, -160 ... -167 missing buffers, -179 card type, -591 ... -599 watchdog not supported,
    -600 digital state, -601, -1051, -1053 an expiration state that must be 0, -797 tristate, -1029, -1073.
[I] A card that was closed has no handle (-88), its tasks none (-105). The first sample comes one period after the start. The
    unread samples of a stopped task are gone. Of two tasks on one clock the second is refused. The watchdog runs on after
    clear, and through close; its expiry is kept until clear, also over close and open. The motor current has the sign of
    AO0, and is 0 with the amplifier off, when the plant sees 0 V (a real motor would then turn freely).
[U] Whether the QUBE-Servo 2 has a watchdog, and which expiration states; the code for I/O after expiry (here -854) and
    whether reading is refused too; whether clear brings the outputs back (here not); whether close or unplugging cuts the
    outputs (here both hold them: the vendor's own programs write 0 V before closing); which calls fail when unplugged
    (here all but is_valid); counts at power-on; the highest rate; the tachometer's filter (here the exact velocity).
Stricter than the real package: a buffer that is too short (there, memory is overrun) or cannot be written (there, it is
written nevertheless) raises ValueError.
"""
