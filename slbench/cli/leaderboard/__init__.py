"""``slbench leaderboard``: frozen scenes, tasks on them, and a scorer."""

from slbench.cli.lazy import Group

group = Group(
    "leaderboard",
    "Tasks on frozen scenes: make them, score predictions.",
    {
        "Commands": {
            "make": "slbench.cli.leaderboard.make:make",
            "score": "slbench.cli.leaderboard.score:score",
        }
    },
)
