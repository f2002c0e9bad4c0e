"""`python -m cosim` is `qube-ihc`."""

from __future__ import annotations

import sys

from .signals import CTRL_C, say


def main() -> None:
    """Run the command line; Ctrl-C while that is loaded ends as it does later."""
    try:
        from .cli import main as run  # noqa: PLC0415 - takes a fifth of a second
    except KeyboardInterrupt as interrupt:
        say(interrupt)
        sys.exit(CTRL_C)
    run()


if __name__ == "__main__":
    main()
