"""Pictures of textures go with a data set, as meshes do."""

import cv2
import numpy as np
import pytest
import tomli_w
from dataset_specs import TINY

from slbench.core.errors import InputError
from slbench.datasets.spec.sampling import draw, place_scene
from slbench.datasets.spec.specification import load


def write(folder, albedo):
    scene = TINY["scene"] | {"materials": {"print": {"bsdf": "diffuse", "albedo": albedo}}}
    block = {"heights_mm": [3.0], "step_length_mm": 15.0, "width_mm": 30.0}
    objects = [{"name": "block", "kind": "step_block", "parameters": block, "material": "print"}]
    path = folder / "tiny.toml"
    path.write_text(tomli_w.dumps(TINY | {"scene": scene, "objects": objects}))
    return path


def box(path):
    return {"texture": "picture", "path": path, "mapping": "box"}


@pytest.mark.parametrize("form", ["path", "choice of paths", "drawn numbers"])
def test_samples_have_the_pictures_that_they_show(form, tmp_path):
    levels = {"a": 60, "b": 200}
    (tmp_path / "maps").mkdir()
    for name, level in levels.items():
        cv2.imwrite(str(tmp_path / "maps" / f"{name}.png"), np.full((4, 4), level, np.uint8))
    albedo = box("maps/a.png")
    if form == "choice of paths":
        albedo["path"] = {"choice": ["maps/a.png", "maps/b.png"]}
    if form == "drawn numbers":
        albedo["size_mm"] = {"uniform": [5.0, 20.0]}
    specification, files = load(write(tmp_path, albedo))
    names = {f"picture.{name}.png" for name in (levels if "choice" in form else "a")}
    assert specification.files() == set(files) == names
    shown, sizes = set(), set()
    for sample in range(8):
        folder = tmp_path / f"{form}-{sample}"
        folder.mkdir()
        scene = place_scene(draw(specification, 1, sample, 0), files, folder, True)
        assert len(list(folder.glob("picture.*"))) == 1 or "choice" in form
        texture = scene.objects[0].material_of("body").bsdf.albedo
        shown.add(round(float(texture.pixels.values.mean()), 3))
        sizes.add(texture.size_mm)
    expected = {0.045, 0.578} if "choice" in form else {0.045}  # sRGB of 60 and 200
    assert shown == expected
    assert len(sizes) == (8 if form == "drawn numbers" else 1)


@pytest.mark.parametrize("path", ["none.png", "../a.png"])
def test_a_picture_that_is_not_there_is_named(path, tmp_path):
    with pytest.raises(InputError, match=r"tiny\.toml: scene\.materials\.print\.albedo\.path"):
        load(write(tmp_path, box(path)))
