"""Export as a COCO data set of instances: a picture a sample, a mask for each object.

The format is that of https://cocodataset.org/#format-data ("object detection", as of 2024) and of
its reader ``pycocotools`` 2.0::

    OUT/annotations.json         images, categories (kinds of objects) and annotations
    OUT/images/000123.png        the scene fully lit by the projector, 8 bit
    OUT/frames/000123_000.png    the pattern frames, where --patterns names some, 8 bit

A mask holds the pixels whose centre's ray meets the object, from the ground truth: nothing is
outlined by polygons.  It is written as uncompressed run lengths, column by column, as COCO's own
``segmentation`` of ``counts`` and ``size`` is.  Objects that no pixel sees have no annotation, and
distractors have none.  A category is a kind of artefact; a mesh file is one of its own.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from slbench.core.io import write_json, write_png
from slbench.datasets.export.frames import eight_bit, write_index
from slbench.datasets.export.registry import Exporter
from slbench.datasets.read.reader import Dataset
from slbench.datasets.read.recipe import Recipe
from slbench.datasets.store.shards import key
from slbench.scene.model import SceneObject


def write_coco(data: Dataset, recipe: Recipe, folder: Path) -> Iterator[int]:
    """Write a selection as a COCO data set.

    Parameters
    ----------
    data : Dataset
    recipe : Recipe
        Of the noise; with patterns, their frames are written too.
    folder : Path
        An empty one.

    Yields
    ------
    int
        Samples written so far.
    """
    write_index(folder / "index.csv", data)
    images: list[dict[str, Any]] = []
    annotations: list[dict[str, Any]] = []
    categories: dict[str, int] = {}
    for done, item in enumerate(data, 1):
        name = key(item.number)
        lit = recipe.lit(item)
        write_png(folder / "images" / f"{name}.png", eight_bit(lit)[0])
        seen = item.truth.object_id
        height, width = seen.shape
        image: dict[str, Any] = {
            "id": item.number,
            "file_name": f"images/{name}.png",
            "width": width,
            "height": height,
        }
        if recipe.patterns is not None:
            shots = recipe.shots(item)
            image["frames"] = [f"frames/{name}_{k:03d}.png" for k in range(len(shots.frames))]
            for file, frame in zip(image["frames"], eight_bit(shots), strict=True):
                write_png(folder / file, frame)
        images.append(image)
        for number, placed in enumerate(item.scene.objects):
            mask = seen == number
            if mask.any() and not placed.distractor:
                category = categories.setdefault(_category(placed), len(categories) + 1)
                annotations.append(
                    {
                        "id": len(annotations) + 1,
                        "image_id": item.number,
                        "category_id": category,
                        "segmentation": {"size": [height, width], "counts": run_lengths(mask)},
                        "area": int(mask.sum()),
                        "bbox": list(cv2.boundingRect(mask.astype(np.uint8))),
                        "iscrowd": 0,
                    }
                )
        yield done
    content = {
        "info": {"description": data.manifest.description or data.manifest.name},
        "licenses": [{"id": 1, "name": data.manifest.licence, "url": ""}],
        "images": [image | {"license": 1} for image in images],
        "categories": [
            {"id": number, "name": kind, "supercategory": "object"}
            for kind, number in categories.items()
        ],
        "annotations": annotations,
    }
    write_json(folder / "annotations.json", content)


def _category(placed: SceneObject) -> str:
    """Return the category of an object: its kind, or the name of its mesh file."""
    artefact = placed.artefact
    return artefact.name.removeprefix("mesh.") if artefact.kind == "mesh" else artefact.kind


def run_lengths(mask: NDArray[np.bool_]) -> list[int]:
    """Return lengths of runs of a mask (V, U), column by column, the first one of False.

    Its length may be zero.
    """
    column_major = np.concatenate(([False], mask.ravel(order="F")))
    # The first run starts before the first pixel, so that its length counts what is not there.
    changes = np.flatnonzero(column_major[1:] != column_major[:-1])
    return [int(n) for n in np.diff(changes, prepend=0, append=mask.size)]


#: The row of :mod:`slbench.datasets.export.registry`.
EXPORTER = Exporter(write_coco)
