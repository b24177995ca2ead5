"""``slbench dataset``: data sets of many scans."""

from slbench.cli.lazy import Group

group = Group(
    "dataset",
    "Data sets of many scans: make, verify, describe, export.",
    {
        "Commands": {
            "make": "slbench.cli.dataset.make:make",
            "verify": "slbench.cli.dataset.verify:verify",
            "info": "slbench.cli.dataset.info:info",
            "export": "slbench.cli.dataset.export:export",
        }
    },
)
