"""Codes that slbench does not have, added to the registry: one along an axis, one of images.

Both are ramps of intensity (B. Carrihill, R. Hummel, CVGIP 32, 1985), whose coordinate is a ratio
of frames and therefore known in closed form.
"""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import pytest
from scenes_small import small, truth_of

from slbench.capture.capture import Capture
from slbench.core.errors import InputError
from slbench.patterns import (
    Code,
    Flat,
    Found,
    Fringes,
    GrayCode,
    PatternSequence,
    decode,
    pattern_codes,
)
from slbench.simulate.scan import scan

PANEL = (96, 60)


@dataclass(frozen=True)
class Ramp(Code):
    """A rising and a falling ramp along one axis, several times, and a white frame."""

    kind: ClassVar[str] = "ramp"
    words: ClassVar[tuple[str, ...]] = ("ramp",)

    axis: str = "u"
    repeats: int = 1

    @property
    def axes(self):
        return (self.axis,)

    def n_frames(self, panel):
        return 2 * self.repeats + 1

    def profile(self, k, size):
        rising = (np.arange(size) + 0.5) / size
        if k == 2 * self.repeats:
            return np.ones(size)
        return 1 - rising if k % 2 else rising

    def may_saturate(self, k):
        return k == 2 * self.repeats  # nothing is decoded from the white frame

    @classmethod
    def read_word(cls, word, axis, shifts):
        name, _, repeats = word.partition("@")
        if name != "ramp":
            return None
        if repeats and not repeats.isdecimal():
            raise InputError("Ramp", "ramp or ramp@2", repr(word))
        return [cls(axis, int(repeats or 1))]

    @property
    def word(self):
        return "ramp" if self.repeats == 1 else f"ramp@{self.repeats}"

    @classmethod
    def decode_run(cls, run, observed, found):
        (placed,) = run.parts
        code, size = placed.code, observed.panel[0 if run.axes == ("u",) else 1]
        first = placed.frames.start
        frames = observed.pixels[first : first + 2 * code.repeats].astype(np.float64)
        frames -= observed.noise.offset_dn
        rising, falling = frames[0::2].mean(axis=0), frames[1::2].mean(axis=0)
        lit = rising + falling
        variance = observed.noise.variance(0.5 * lit + observed.noise.offset_dn) / code.repeats
        with np.errstate(divide="ignore", invalid="ignore"):
            share = rising / lit
            sigma = size * np.sqrt(variance * (share**2 + (1 - share) ** 2)) / lit
        mask = (0.5 * lit >= observed.min_modulation) & (share > 0) & (share < 1)
        evidence = {placed.index: {"share": share}} if observed.keep_evidence else {}
        return {
            code.axis: Found(
                coordinate=size * share - 0.5,
                sigma=sigma,
                modulation=0.5 * lit,
                mean=0.5 * lit,
                mask=mask,
                evidence=evidence,
            )
        }


@dataclass(frozen=True)
class Slopes(Code):
    """Three images that code both axes at once: (x + y) / 2, (1 + x - y) / 2 and their sum's white.

    How bright they are stands in a file beside the one that names the code.
    """

    kind: ClassVar[str] = "slopes"
    words: ClassVar[tuple[str, ...]] = ("slopes",)

    top: float = 1.0

    @property
    def axes(self):
        return ("u", "v")

    def n_frames(self, panel):
        return 3

    def image(self, k, panel):
        x = (np.arange(panel[0]) + 0.5) / panel[0]
        y = ((np.arange(panel[1]) + 0.5) / panel[1])[:, np.newaxis]
        return self.top * (0.5 * (x + y), 0.5 * (1 + x - y), np.ones((panel[1], panel[0])))[k]

    @classmethod
    def from_table(cls, table, folder):
        return cls(float((folder / table["file"]).read_text()))

    def to_table(self, folder):
        (folder / "slopes.txt").write_text(f"{self.top}")
        return {"file": "slopes.txt"}

    @classmethod
    def read_word(cls, word, axis, shifts):
        return [cls()] if word == "slopes" else None

    @property
    def word(self):
        return "slopes"

    @classmethod
    def decode_run(cls, run, observed, found):
        first = run.parts[0].frames.start
        frames = observed.pixels[first : first + 3].astype(np.float64) - observed.noise.offset_dn
        with np.errstate(divide="ignore", invalid="ignore"):
            one, two = frames[0] / frames[2], frames[1] / frames[2]
        shares = {"u": one + two - 0.5, "v": one - two + 0.5}
        deviation = np.sqrt(observed.noise.variance(frames[2])) / np.maximum(frames[2], 1e-9)
        return {
            axis: Found(
                coordinate=size * shares[axis] - 0.5,
                sigma=2 * size * deviation,
                modulation=frames[2],
                mean=frames[2],
                mask=frames[2] >= observed.min_modulation,
            )
            for axis, size in zip("uv", observed.panel, strict=True)
        }


@pytest.fixture(autouse=True)
def registered(monkeypatch):
    """Both codes in the registry, for one test."""
    for name in ("_found", "_added"):
        monkeypatch.setattr(pattern_codes, name, dict(getattr(pattern_codes, name)))
    pattern_codes.add("ramp", Ramp)
    pattern_codes.add("slopes", Slopes)


def test_a_table_names_it():
    table = {"panel": list(PANEL), "parts": [{"kind": "ramp", "axis": "v", "repeats": 2}]}
    sequence = PatternSequence.from_dict(table)
    assert sequence.parts == (Ramp("v", 2),)
    assert sequence.to_dict() == table
    table["parts"][0]["repeat"] = 3
    with pytest.raises(
        InputError, match=r"parts\[0\]: expected one of the keys axis, repeats.*did"
    ):
        PatternSequence.from_dict(table)
    with pytest.raises(InputError, match="did you mean 'ramp'"):
        PatternSequence.from_dict({"panel": PANEL, "parts": [{"kind": "romp"}]})


@pytest.mark.parametrize("axes", ["u", "uv"])
def test_the_short_text_has_words_for_it(axes):
    sequence = PatternSequence.parse("white+ramp@2+4,8@5+slopes", PANEL, axes=axes)
    along_u = (Flat(1.0), Ramp("u", 2), Fringes(4, 5), Fringes(8, 5), Slopes())
    along_v = (Ramp("v", 2), Fringes(4, 5, "v"), Fringes(8, 5, "v"))
    # What codes both axes is shown once, like the white frame.
    assert sequence.parts == along_u + (along_v if axes == "uv" else ())
    assert PatternSequence.parse("ramp+8", PANEL).name == "ramp+8"
    with pytest.raises(InputError, match=r'patterns "ramp@x": expected ramp or ramp@2'):
        PatternSequence.parse("ramp@x", PANEL)
    with pytest.raises(InputError, match="did you mean 'slopes'"):
        PatternSequence.parse("slope", PANEL)


def test_a_code_kept_in_a_file_goes_with_the_capture(tmp_path):
    sequence = PatternSequence(PANEL, (Slopes(0.75),))
    frames = np.rint(200 * sequence.images()).astype(np.uint8)
    Capture(frames, sequence).save(tmp_path)
    found = Capture.load(tmp_path)
    assert found.sequence == sequence
    assert (tmp_path / "slopes.txt").read_text() == "0.75"


def test_frames_are_asked_for_by_what_they_vary_along():
    sequence = PatternSequence(PANEL, (Flat(1.0), Slopes(), Ramp("v")))
    assert sequence.variations == ("uv", "v")
    assert sequence.frames_along("uv").tolist() == [0, 1, 2, 3]
    assert sequence.frames_along("v").tolist() == [4, 5, 6]
    images = sequence.images()
    np.testing.assert_array_equal(sequence.shown(np.arange(4), "uv"), images[:4])
    np.testing.assert_array_equal(sequence.shown(np.array([5]), "v")[0], images[5][:, 0])


def plane(axes="u"):
    """The small plane, and where its surface is lit and smooth."""
    return small("plane", axes=axes), truth_of("plane")


@pytest.mark.parametrize("text", ["ramp@8", "white+ramp@8+16"])
def test_a_code_along_an_axis_is_scanned_and_decoded(text):
    scene, truth = plane()
    result = scan(scene.with_patterns(text), seed=3)
    seen = truth.smooth() & result.phase.mask
    assert seen.sum() > 0.95 * truth.smooth().sum()
    error = (result.phase.coordinate["u"] - truth.panel[..., 0])[seen]
    if text.endswith("16"):
        # The ramp finds the order, fringes the place: the error is theirs, and no order is wrong.
        period = scene.sequence.size("u") / 16
        assert np.abs(error).max() < 0.25 * period
        noise = np.median(result.phase.sigma["u"][seen])
        # Noise and what the renderer leaves without noise; the deviation of some 10,000 pixels
        # scatters by less than a hundredth.
        assert error.std() == pytest.approx(np.hypot(noise, result.floor_rms_px), rel=0.1)
    else:
        # The panel's 8 bits show the ramp in steps of a 255th, which camera pixels do not resolve:
        # the error may be as large as the noise with a whole step uniformly added.
        step = scene.sequence.size("u") / 255
        bound = np.hypot(np.median(result.phase.sigma["u"][seen]), step / np.sqrt(12))
        assert error.std() < 1.1 * bound
        assert abs(np.median(error)) < 0.25 * step


def test_a_code_of_images_is_scanned_and_decoded_along_both_axes():
    scene, truth = plane("uv")
    result = scan(scene.with_patterns("slopes", axes="uv"), noise=False)
    assert set(result.transport.marginals) == {"uv"}
    seen = truth.smooth() & result.phase.mask
    assert seen.sum() > 0.95 * truth.smooth().sum()
    for k, axis in enumerate("uv"):
        error = (result.phase.coordinate[axis] - truth.panel[..., k])[seen]
        # Two frames of 8 bits, read from a panel of 8 bits: rounding of half a step each.
        step = scene.sequence.size(axis) / 255
        assert np.abs(error).max() < 4 * step
        assert abs(np.median(error)) < 0.5 * step


def test_only_frames_that_may_not_saturate_are_searched():
    sequence = PatternSequence(PANEL, (Ramp(),))
    frames = np.full((3, 1, 3), 100.0)
    frames[2, 0, 0] = 255.0  # the white frame, without harm
    frames[2, 0, 1] = np.nan
    frames[1, 0, 2] = 255.0
    found = decode(frames, sequence, saturation=255.0)
    assert found.mask.tolist() == [[True, True, False]]
    assert np.isnan(found.coordinate["u"]).tolist() == [[False, False, True]]


def test_codes_of_one_family_along_one_axis_are_decoded_together():
    parts = (Ramp(), Fringes(8), Ramp("v"), Flat(0.5), Fringes(16), Slopes(), Fringes(4), Ramp())
    runs = PatternSequence(PANEL, parts).runs()
    # Codes of other axes and flat frames do not part a run; a code of both axes does.  Fringes are
    # told apart by all others, wherever they stand.
    assert [[placed.index for placed in run.parts] for run in runs] == [
        [0], [2], [5], [7], [1, 4, 6],
    ]  # fmt: skip
    with pytest.raises(InputError, match=r"parts\[1\]: expected the Gray code before"):
        PatternSequence(PANEL, (Ramp(), GrayCode())).runs()


def test_its_evidence_is_kept_where_asked_for():
    sequence = PatternSequence(PANEL, (Flat(0.0), Ramp()))
    frames = np.array([0.0, 50.0, 150.0, 200.0])[:, np.newaxis, np.newaxis]
    assert decode(frames, sequence).evidence == {}
    evidence = decode(frames, sequence, keep_evidence=True).evidence
    assert evidence[1]["share"].tolist() == [[0.25]]
