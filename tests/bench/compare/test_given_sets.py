"""Sets of every form, and decoders of the user's own, are compared as all others are."""

import hashlib
from dataclasses import replace

import numpy as np
import pytest
import tomli_w
from scenes_small import SMALL_FILE, check_refused, run_cli, small, transport_of, truth_of

from slbench.bench.compare.compare import compare
from slbench.bench.compare.sets import PatternSet, pattern_sets
from slbench.bench.compare.suite import compare_suite
from slbench.capture.shown import write_pictures
from slbench.core.errors import InputError
from slbench.core.io import read_json
from slbench.patterns import Fringes, PatternSequence, PhaseMap, decode

NAME = "step-block"
TEXT = "1,10,50"
MODULE = """
from slbench.patterns import Fringes, PatternSequence, decode as own

SET = [Fringes(1, 3, "u"), Fringes(8, 4, "u")]


def doubled(panel):
    return PatternSequence(panel, tuple(Fringes(n, 3, "u") for n in (1, 4, 16)))


def decode(frames, sequence):
    return own(frames, sequence)


def fails(frames, sequence):
    return frames[100]
"""


@pytest.fixture(scope="module")
def scene():
    return small(NAME)


@pytest.fixture
def folder(tmp_path, monkeypatch, scene):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "mine.py").write_text(MODULE)
    parts = scene.with_patterns("1,20").sequence.to_dict()["parts"]
    for name in ("set.toml", "other/set.toml"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text(tomli_w.dumps({"parts": parts}))
    write_pictures(scene.with_patterns("gray").sequence, tmp_path / "session")
    return tmp_path


def compared(scene, sets, repeats=4, **options):
    light = {"transports": (transport_of(NAME),), "truth": truth_of(NAME)}
    return compare(scene, sets, repeats=repeats, **light, **options)


def test_sets_of_every_form_are_compared(folder, scene):
    sets = ["1,8", "set.toml", "session", "mine.py:SET", "mine.py:doubled", "1,10|mine.py:decode"]
    found = compared(scene, sets, 2, allow_modules=True)
    names = [one.name for one in found.sets]
    assert names == ["1,8", "set", "session", "mine:SET", "mine:doubled", "1,10|mine:decode"]
    texts = ["1,8", "1,20", "gray", "1@3,8@4", "1,4,16", "1,10"]
    assert [one.sequence.name for one in found.sets] == texts
    assert all(one.completeness > 0.9 for one in found.sets)
    assert all(one.order_error_rate < 0.05 for one in found.sets)


def test_sets_of_one_name_are_told_apart(folder, scene):
    sets = pattern_sets(["set.toml", "other/set.toml", "1,8"], scene)
    assert [one.name for one in sets] == ["set.toml", "other/set.toml", "1,8"]
    for twice in (["set.toml", "set.toml"], ["1,8", "1, 8"], [Fringes(1), Fringes(1)]):
        with pytest.raises(InputError, match="every set once"):
            pattern_sets(twice, scene)


def noisy(scene):
    """Return the package's decoder under the scene's own noise, as a user would call it."""

    def decoder(frames, sequence):
        return decode(frames, sequence, noise=scene.detector.noise_model(), saturation=255)

    return decoder


def test_a_decoder_is_scored_as_the_codes_own_is(scene):
    """The same decoder in the user's hands gives the same numbers, on the same frames."""
    sequence = scene.with_patterns(TEXT).sequence
    own = compared(scene, [TEXT])[TEXT]
    users = compared(scene, [PatternSet(TEXT, sequence, decoder=noisy(scene))])[TEXT]
    for name in ("std_median_mm", "error_median_mm", "floor_median_mm", "predicted_mm", "right"):
        assert getattr(users, name) == pytest.approx(getattr(own, name), rel=1e-6), name
    assert users.completeness == own.completeness
    # The light is found from the frames instead of from the last set: per mille.
    assert users.bound_share == pytest.approx(own.bound_share, rel=5e-3)
    assert users.bound_mm == pytest.approx(own.bound_mm, rel=5e-3)


def test_the_share_of_the_bound_is_that_of_the_measured_noise(scene):
    """What a decoder predicts, and what it says of the light, does not touch it."""
    sequence = scene.with_patterns(TEXT).sequence

    def boastful(frames, sequence):
        found = noisy(scene)(frames, sequence)
        sigma = {axis: np.ones_like(one) for axis, one in found.sigma.items()}
        return PhaseMap(found.coordinate, sigma, 9 * found.modulation, 0 * found.mean, found.mask)

    def wasteful(frames, sequence):
        """Decode with noise of its own: half of the variance is the decoder's."""
        found = noisy(scene)(frames, sequence)
        rng = np.random.default_rng(int(frames.sum()) % 2**32)
        shaken = {a: x + rng.normal(0, found.sigma[a]) for a, x in found.coordinate.items()}
        return replace(found, coordinate=shaken)

    sets = [
        PatternSet(TEXT, sequence),
        PatternSet("boastful", sequence, decoder=boastful),
        PatternSet("wasteful", sequence, decoder=wasteful),
    ]
    found = compared(scene, sets, 6)
    # Some 1,900 pixels with five degrees of freedom each: the RMS is known to 0.8 %.
    best = found[TEXT].bound_share
    assert found["boastful"].bound_share == pytest.approx(best, rel=0.03)
    assert found["wasteful"].bound_share == pytest.approx(best / np.sqrt(2.0), rel=0.05)
    assert found["boastful"].std_over_predicted != pytest.approx(1.0, rel=0.3)


def changed(**parts):
    """Return a decoder that gets everything right but the parts that are given."""

    def decoder(frames, sequence):
        found = decode(frames, sequence)
        return replace(found, **{name: part(getattr(found, name)) for name, part in parts.items()})

    return decoder


def lost(frames, sequence):
    raise SystemExit(3)


@pytest.mark.parametrize(
    ("decoder", "words"),
    [
        (lambda frames, sequence: frames[100], "runs, got IndexError"),
        (lambda frames: frames, "runs, got TypeError"),
        (lost, "runs, got SystemExit(3)"),
        (lambda frames, sequence: None, "expected a slbench.patterns.PhaseMap, got NoneType"),
        (changed(mask=lambda m: m[:-1]), "mask: expected bool of shape (120, 160), got bool of"),
        (
            changed(mask=lambda m: m.astype(float)),
            "mask: expected bool of shape (120, 160), got fl",
        ),
        (changed(mask=lambda m: [1]), "mask: expected bool of shape (120, 160), got [1]"),
        (changed(coordinate=lambda c: {}), "coordinate: expected a dict with u, got []"),
        (changed(coordinate=lambda c: {"v": c["u"]}), "a dict with u, got ['v']"),
        (changed(coordinate=lambda c: c["u"]), "a dict with u, got ndarray"),
        (
            changed(coordinate=lambda c: {"u": c["u"].T}),
            "coordinate['u']: expected floats of shape",
        ),
        (changed(coordinate=lambda c: {"u": c["u"] * np.nan}), "['u']: expected numbers inside"),
        (changed(sigma=lambda s: {"u": 0 * s["u"]}), "sigma['u']: expected deviations > 0"),
        (changed(sigma=lambda s: {"u": np.full(s["u"].shape, "x")}), "sigma['u']: expected floats"),
        (changed(modulation=lambda b: b[0]), "modulation: expected floats of shape (120, 160)"),
        (changed(mean=lambda a: None), "mean: expected floats of shape (120, 160), got None"),
    ],
)
def test_a_decoder_that_is_none_is_named_in_one_line(scene, decoder, words):
    sequence = scene.with_patterns("1,8").sequence
    with pytest.raises(InputError) as caught:
        compared(scene, [PatternSet("mine", sequence, decoder=decoder)], 2)
    message = str(caught.value)
    assert message.startswith("set mine: decoder")
    assert words in message
    assert len(message.splitlines()) == 1


def test_a_decoder_may_decode_what_no_code_of_the_package_does(scene):
    """One set of eight fringes, whose orders the user knows from the rig."""
    alone = PatternSequence(scene.sequence.panel, (Fringes(8, 4, "u"),), unwrap="sequential")
    with pytest.raises(InputError):
        pattern_sets([alone], scene)
    (one,) = pattern_sets(
        [PatternSet("alone", alone, decoder=lambda frames, sequence: None)], scene
    )
    assert one.sequence == alone


def test_the_panel_is_the_scene_s(scene):
    other = PatternSequence.parse("1,8", (64, 48))
    for given in (other, PatternSet("other", other)):
        with pytest.raises(
            InputError, match=r"expected patterns for the panel's \d+ x \d+ px, got 64"
        ):
            pattern_sets([given], scene)


def test_equal_frames_and_photons_of_sets_of_every_form(folder, scene):
    given = ["set.toml", "mine.py:doubled", "1,8 | mine.py:decode"]
    frames = pattern_sets(given, scene, equal="frames", allow_modules=True)
    assert [one.frames for one in frames] == [9, 9, 9]
    assert frames[2].decoder is not None
    photons = pattern_sets(given, scene, equal="photons", allow_modules=True)
    assert [one.exposure_share * one.frames for one in photons] == pytest.approx([6, 6, 6])


def test_channels_of_one_picture_are_one_exposure(scene):
    given = ["1,16@3+rgb", "1,16@3", "1,16@4+rgb"]  # two pictures, six and three
    photons = pattern_sets(given, scene, equal="photons")
    assert [one.exposure_share for one in photons] == pytest.approx([1.0, 2 / 6, 2 / 3])
    frames = pattern_sets([given[0], "1@3"], scene, equal="frames")
    assert [one.frames for one in frames] == [6, 3]
    frames = pattern_sets([given[0], "1,16@4"], scene, equal="frames")
    assert frames[0].note == "keeps its 2 colour pictures"


def test_the_command_takes_them(folder):
    (folder / "scene.toml").write_text(tomli_w.dumps(SMALL_FILE | {"name": "tiny"}))
    command = ["compare", "scene.toml", "--repeats", 2, "--out", "out", "--json"]
    sets = ["--set", "set.toml", "--set", "1,10 | mine.py:decode"]
    check_refused(run_cli(*command, *sets), "decoder", "--allow-modules", "mine.py:decode")
    done = run_cli(*command, *sets, "--allow-modules")
    assert done.status == 0, done.err
    written = read_json(folder / "out" / "comparison.json")
    assert [one["name"] for one in written["sets"]] == ["set", "1,10|mine:decode"]
    assert (folder / "out" / "maps" / "1_10_mine_decode.exr").is_file()
    ran = read_json(folder / "out" / "provenance.json")["extensions"]["modules"]
    digest = hashlib.sha256(MODULE.encode()).hexdigest()
    assert digest in [module["sha256"] for module in ran]
    fails = ["--set", "1,10 | mine.py:fails", "--allow-modules"]
    check_refused(run_cli(*command, *fails), "set 1,10|mine:fails: decoder", "IndexError")
    none = ["--set", "1,10 | mine.py:SET", "--allow-modules"]
    check_refused(run_cli(*command, *none), "a function of frames and sequence", "list")


def test_a_suite_takes_them(folder):
    (folder / "scene.toml").write_text(tomli_w.dumps(SMALL_FILE | {"name": "tiny"}))
    sets = ["mine.py:doubled", "1,10 | mine.py:decode"]
    found = compare_suite(sets, ["scene.toml"], repeats=2, allow_modules=True)
    assert found.sets == ("mine:doubled", "1,10|mine:decode")
    assert all(one.right > 0.9 for one in found.outcomes)
