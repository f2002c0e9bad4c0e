"""Plain integers under names; the real package has no enum.Enum either."""


class Clock:
    """The clocks that can pace a task."""

    SYSTEM_CLOCK_4 = -4
    SYSTEM_CLOCK_3 = -3
    SYSTEM_CLOCK_2 = -2
    SYSTEM_CLOCK_1 = -1
    HARDWARE_CLOCK_0 = 0
    HARDWARE_CLOCK_1 = 1
    HARDWARE_CLOCK_2 = 2


class BufferOverflowMode:
    """What becomes of samples when the task buffer is full."""

    ERROR_ON_OVERFLOW = 0
    OVERWRITE_ON_OVERFLOW = 1
    DISCARD_ON_OVERFLOW = 2
    WAIT_ON_OVERFLOW = 3
    SYNCHRONIZED = 4


class DigitalState:
    """The states a digital output can expire to."""

    LOW = 0
    HIGH = 1
    TRISTATE = 2
    NO_CHANGE = 3


class IntegerProperty:
    """Integer properties of a board."""

    VENDOR_ID = 0
    PRODUCT_ID = 1


class StringProperty:
    """String properties of a board."""

    MANUFACTURER = 0
    PRODUCT_NAME = 1
    MODEL_NAME = 2
    SERIAL_NUMBER = 3
    FIRMWARE_VERSION = 4
