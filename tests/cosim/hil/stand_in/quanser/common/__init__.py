"""Error codes and the exception that carries one."""

from __future__ import annotations

MESSAGES = {
    88: "the card handle is not valid",
    105: "the task handle is not valid",
    107: "the driver of the board could not be opened",
    108: "no such board was found",
    109: "the board is in use by another process",
    111: "the task buffer has overflowed",
    121: "invalid analog input channel",
    124: "invalid encoder input channel",
    127: "invalid digital input channel",
    130: "invalid other input channel",
    133: "invalid analog output channel",
    134: "PWM outputs are not supported by this board",
    139: "invalid digital output channel",
    142: "invalid other output channel",
    143: "a digital channel cannot be input and output",
    144: "the clock is not supported",
    145: "the hardware clock is in use",
    149: "the frequency must be positive",
    150: "the frequency is too high for the clock",
    159: "more samples requested than the task buffer holds",
    160: "missing analog input buffer",
    161: "missing encoder input buffer",
    162: "missing digital input buffer",
    163: "missing other input buffer",
    164: "missing analog output buffer",
    165: "missing PWM output buffer",
    166: "missing digital output buffer",
    167: "missing other output buffer",
    179: "the board type is not recognized",
    316: "missing encoder counts",
    320: "the number of samples in the task buffer must be positive",
    321: "the number of samples must be positive",
    591: "watchdog_set_analog_expiration_state is not supported by this card",
    592: "watchdog_set_digital_expiration_state is not supported by this card",
    594: "watchdog_set_other_expiration_state is not supported by this card",
    595: "watchdog_start is not supported by this card",
    596: "watchdog_stop is not supported by this card",
    597: "watchdog_reload is not supported by this card",
    598: "watchdog_is_expired is not supported by this card",
    599: "watchdog_clear is not supported by this card",
    600: "invalid digital state",
    601: "analog outputs can only expire to zero",
    607: "the clock period is too low",
    681: "the property is not recognized",
    797: "digital outputs cannot expire to tristate",
    843: "the driver timed out",
    854: "the card is not active",
    1029: "the device is not connected",
    1051: "digital outputs can only expire to zero",
    1053: "other outputs can only expire to zero",
    1073: "the board is already opened by another process",
    1080: "invalid buffer mode",
}


class GenericError(Exception):
    """An error of the library; `error_code` is negative."""

    def __init__(self, error_code: int) -> None:
        self.error_code = error_code

    def get_error_message(self, locale: str | None = None, buffer_size: int = -1) -> str:
        """Return what the code means, in the stand-in's own words."""
        return MESSAGES.get(-self.error_code, f"error {-self.error_code}")
