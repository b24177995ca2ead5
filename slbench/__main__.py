"""The command ``slbench``, also as ``python -m slbench``."""

import os
import signal
from types import FrameType


def main() -> None:
    """Run the command line and exit; Ctrl-C ends it in one word from the first moment on."""
    signal.signal(signal.SIGINT, _leave)  # while modules are imported, nothing needs cleaning up
    from slbench.cli import main as run

    signal.signal(signal.SIGINT, signal.default_int_handler)
    run()


def _leave(number: int, frame: FrameType | None) -> None:
    os.write(2, b"interrupted\n")
    os._exit(130)


if __name__ == "__main__":
    main()
