"""``slbench calibrate``: calibrate by one model of all pixels, and measure with it."""

from slbench.cli.lazy import Group

group = Group(
    "calibrate",
    "Calibrate by one model of all pixels, and measure with it.",
    {
        "Commands": {
            "fit": "slbench.cli.calibrate.fit:fit",
            "apply": "slbench.cli.calibrate.apply:apply",
            "run": "slbench.cli.calibrate.run:run",
        }
    },
)
