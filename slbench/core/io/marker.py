"""The mark of a folder whose files are just being replaced.

Files of a folder are swapped in one after another.  Until the last has come, a file
``.slbench-incomplete`` lies in the folder and lists them; a process that is killed leaves it, and
readers refuse the files that it lists, since new ones may lie beside old ones.
"""

import json
from pathlib import Path
from typing import Any

from slbench.core.errors import InputError

MARKER = ".slbench-incomplete"
_LEVELS = 4  # that a file of an output folder may lie deep, with room


def read_marker(folder: Path) -> dict[str, Any] | None:
    """Return what a folder's mark says, or None where there is no mark.

    Returns
    -------
    dict or None
        ``files``, a list of digests by name; empty where the mark cannot be read.
    """
    try:
        content = json.loads((folder / MARKER).read_text(encoding="utf-8"))
    except (FileNotFoundError, NotADirectoryError):
        return None
    except (OSError, ValueError):
        return {}
    return content if isinstance(content, dict) else {}


def check_whole(path: Path) -> None:
    """Refuse a file that belongs to a folder whose writing was cut off.

    Raises
    ------
    InputError
        Naming the folder, and that the command must be run again.
    """
    for folder in path.absolute().parents[:_LEVELS]:
        mark = read_marker(folder)
        if mark is None:
            continue
        files = mark.get("files")
        name = path.absolute().relative_to(folder).as_posix()
        if not isinstance(files, dict) or name in files:
            found = f"one whose writing was cut off ({MARKER}): run its command again"
            raise InputError(folder, "a whole folder", found)
