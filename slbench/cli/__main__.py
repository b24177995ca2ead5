"""``python -m slbench.cli``: the command line without its console script."""

from slbench.cli import main

main()
