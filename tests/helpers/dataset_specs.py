"""A specification of tiny samples, and what several tests of making data sets share."""

from pathlib import Path
from typing import Any

import tomli_w

from slbench.datasets.store import index
from slbench.datasets.store.storage import Storage

#: Five objects in two shards are enough to show all that shards and order could spoil.
TINY: dict[str, Any] = {
    "name": "tiny",
    "licence": "CC0-1.0",
    "samples_per_shard": 2,
    "scene": {
        "extends": "hardware/macro-ch6",
        "camera": {"resolution_px": [48, 36], "pitch_um": 98.6},
        "render": {"samples": 16},
        "exposure": {"white_level": {"uniform": [0.5, 0.9]}},
        "rig": {"alpha_p_deg": {"normal": [0.0, 0.1], "within": [-0.3, 0.3], "add": True}},
    },
    "objects": [
        {
            "name": "block",
            "weight": 2,
            "kind": "step_block",
            "position_mm": [{"uniform": [-5.0, 5.0]}, 0.0, 0.0],
            "parameters": {
                "heights_mm": [{"uniform": [1.0, 5.0], "name": "height_mm"}],
                "step_length_mm": {"integers": [12, 18]},
                "width_mm": 30.0,
            },
        },
        {
            "name": "ball",
            "kind": "sphere",
            "material": {"choice": ["matt-white-spray", "grey-plastic"]},
            "parameters": {"radius_mm": {"log_uniform": [8.0, 20.0]}, "max_form_error_um": 50.0},
        },
    ],
    "patterns": [{"sequence": "1,10", "repeats": 2}],
    "constraints": {"inside_volume": True, "min_lit_share": 0.01},
}


def write_spec(folder: Path, **changes: Any) -> Path:
    """Write :data:`TINY`, some keys changed or (None) left out, and return its path."""
    path = folder / "tiny.toml"
    content = {key: value for key, value in (TINY | changes).items() if value is not None}
    path.write_text(tomli_w.dumps(content))
    return path


def rows_of(url: str | Path) -> list[dict[str, Any]]:
    """Return the rows of a data set's index."""
    return index.decode(Storage(str(url)).read(index.INDEX), "index")


def hashes(url: str | Path) -> list[str | None]:
    """Return the SHA-256 of every sample."""
    return [row["sha256"] for row in rows_of(url)]
