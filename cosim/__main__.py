"""`python -m cosim` is `qube-ihc`."""

from .cli import main

if __name__ == "__main__":
    main()
