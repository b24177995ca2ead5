"""The scenes of the leaderboard as they are made, and the files that entrants are given."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from slbench.core.errors import InputError
from slbench.core.io import OutputFolder
from slbench.datasets.read.reader import Dataset, open_dataset
from slbench.datasets.store.sample import RIG
from slbench.leaderboard.frozen import check_manifest
from slbench.leaderboard.scenes import CAPTURE, Scene

#: What `slbench leaderboard make` writes: the data set, and what entrants are given.
DATA, INPUTS = "data", "inputs"
INPUTS_FOLDER = OutputFolder("leaderboard inputs", ("*",))


@dataclass(frozen=True)
class Board:
    """The scenes of a leaderboard that was made.

    Parameters
    ----------
    folder : Path
    data : Dataset
    """

    folder: Path
    data: Dataset

    def __len__(self) -> int:
        return len(self.data)

    def __iter__(self) -> Iterator[Scene]:
        return (Scene(sample) for sample in self.data)

    @property
    def keys(self) -> list[str]:
        """Names of predictions, in order."""
        return [str(row["key"]) for row in self.data.rows]


def open_board(folder: str | Path) -> Board:
    """Open what ``slbench leaderboard make`` has written.

    Raises
    ------
    InputError
        If it is none, is not finished, or holds other scenes than those that are frozen.
    """
    place = Path(folder)
    if not (place / DATA).is_dir():
        expected = "a leaderboard, with data/ (slbench leaderboard make OUT)"
        raise InputError(place, expected, "none" if place.is_dir() else "no folder of that name")
    data = open_dataset(place / DATA)
    check_manifest(data.manifest, str(place / DATA))
    if data.failed:
        first = data.failed[0]
        expected = "all scenes (slbench leaderboard make OUT --resume tries them again)"
        got = f"{len(data.failed)} that failed, {first['key']} by: {first['reason']}"
        raise InputError(place / DATA, expected, got)
    return Board(place, data)


def write_inputs(board: Board, on_progress: Callable[[float], None] | None = None) -> None:
    """Write what entrants are given, a folder a scene in ``inputs/``.

    ``frame.000.png`` to ``frame.005.png``; ``rig.yaml``, camera and projector; ``phase.npy``, the
    phase of frames 3 to 5 that fringe orders belong to, rad in [0, 2 pi); ``depth.npy``, the
    decoded depth that is to be completed, mm, NaN where there is none.  Maps are float32, (V, U).
    """
    parameters = {"specification": board.data.manifest.name, "scenes": len(board)}
    with INPUTS_FOLDER.writing(board.folder / INPUTS, parameters, None) as temporary:
        for done, scene in enumerate(board, 1):
            place = temporary / scene.key
            place.mkdir()
            for k in range(len(scene.frames)):
                name = f"frame.{k:03d}.png"
                (place / name).write_bytes(scene.sample.member(f"{CAPTURE}.{name}"))
            (place / RIG).write_bytes(scene.sample.member(RIG))
            np.save(place / "phase.npy", scene.phase.astype(np.float32))
            np.save(place / "depth.npy", scene.decoded_depth.astype(np.float32))
            if on_progress:
                on_progress(done / len(board))
