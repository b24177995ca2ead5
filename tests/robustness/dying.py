"""The command line, in a process that dies at a chosen change of the file system.

``python dying.py COUNT WORDS...`` runs ``slbench WORDS`` and ends the process, without any cleaning
up, before the change number COUNT (from 0): a rename, a removal of a file or of a folder.  What
happens within temporary folders is invisible and is not counted.  At its end a process that lived
prints the number of changes as the last line of stderr.
"""

import os
import sys

from slbench.core.io.scratch import is_scratch


def main() -> None:
    """Patch, and run the command line."""
    limit, words = int(sys.argv[1]), sys.argv[2:]
    count = 0

    def dying(name: str) -> None:
        real = getattr(os, name)

        def call(*args: object, **options: object) -> object:
            nonlocal count
            target = os.fspath(args[-1 if name in ("replace", "rename") else 0])
            inside = any(is_scratch(part) for part in os.path.abspath(target).split(os.sep))
            if not inside and "dir_fd" not in options:
                if count == limit:
                    os._exit(9)
                count += 1
            return real(*args, **options)

        setattr(os, name, call)

    for name in ("replace", "rename", "unlink", "remove", "rmdir"):
        dying(name)
    sys.argv = ["slbench", *words]
    from slbench.cli import main as run

    try:
        run()
    finally:
        print(f"\nchanges: {count}", file=sys.stderr)


if __name__ == "__main__":
    main()
