"""``slbench calibrate``: a rig from boards, or one model of all pixels, and measure with it."""

from slbench.cli.lazy import Group

group = Group(
    "calibrate",
    "Calibrate a rig from boards, or by one model of all pixels.",
    {
        "Commands": {
            "board": "slbench.cli.calibrate.board:board",
            "combine": "slbench.cli.calibrate.combine:combine",
            "points": "slbench.cli.calibrate.points:points",
            "planes": "slbench.cli.calibrate.planes:planes",
            "fit": "slbench.cli.calibrate.fit:fit",
            "apply": "slbench.cli.calibrate.apply:apply",
            "run": "slbench.cli.calibrate.run:run",
        }
    },
)
