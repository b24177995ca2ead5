"""The command ``slbench``, also as ``python -m slbench``."""

import os
import signal
from types import FrameType

_INTERRUPTED = 130


def main() -> None:
    """Run the command line and exit; Ctrl-C ends it in one word from the first moment on."""
    signal.signal(signal.SIGINT, _leave)  # while modules are imported, nothing needs cleaning up
    from slbench.cli import main as run

    signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        run()
    except SystemExit as ending:
        if ending.code == _INTERRUPTED:
            # All is cleaned up and said.  Python itself would end by the signal once more where the
            # interrupt came in code that an extension ran.
            os._exit(_INTERRUPTED)
        raise


def _leave(number: int, frame: FrameType | None) -> None:
    os.write(2, b"interrupted\n")
    os._exit(_INTERRUPTED)


if __name__ == "__main__":
    main()
