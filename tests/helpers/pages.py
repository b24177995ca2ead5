"""The documentation's pages as the tests read them."""

import functools
import re
from pathlib import Path

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"
PAGES = sorted(DOCS.rglob("*.md"))
#: The pages that show commands or link to others.
ALL = [ROOT / "README.md", *PAGES]

FENCE = re.compile(r"^( *)```(\S*)\n(.*?)^\1```", re.MULTILINE | re.DOTALL)
#: A line that starts with the command's name, in any fenced or indented block.
_COMMAND = re.compile(r"^(?:    |\$ )?(slbench [a-z].*)$", re.MULTILINE)
_INLINE = re.compile(r"`(slbench [a-z][^`]*)`")


@functools.cache
def text_of(path: Path) -> str:
    """Return the text of a page."""
    return path.read_text(encoding="utf-8")


def shown_commands(path: Path) -> list[str]:
    """Return the command lines in the blocks of a page; of ``A; slbench B`` both."""
    lines = _COMMAND.findall(text_of(path).replace("\\\n", " "))
    return [part.strip() for line in lines for part in re.sub(r"\s#.*", "", line).split(";")]


def named_commands(path: Path) -> list[str]:
    """Return the commands that stand in a sentence, which may lack arguments."""
    return [" ".join(text.split()) for text in _INLINE.findall(text_of(path))]
