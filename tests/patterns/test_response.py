"""A projector's known response is taken out of fringes."""

from dataclasses import replace

import numpy as np
import pytest

from slbench.capture.capture import Capture
from slbench.capture.shown import pictures
from slbench.core.errors import InputError
from slbench.core.io import write_table
from slbench.patterns import NoiseModel, PatternSequence, Response, decode
from slbench.patterns.codes.periodic import PeriodicCode
from slbench.patterns.images import Images

PANEL = (640, 480)
#: An S, steep in the middle, that is not its own mirror: three shifts see such a one as straight.
V = np.linspace(0.0, 1.0, 33)
W = V**1.3
S_CURVE = Response(
    curve=tuple(zip(V.tolist(), (3 * W**2 - 2 * W**3 + 0.1 * V).tolist(), strict=True))
)
RESPONSES = {
    "gamma 0.45": Response(0.45),
    "linear": Response(),
    "gamma 1.8": Response(1.8),
    "gamma 2.2": Response(2.2),
    "S": S_CURVE,
}
PLACES = np.linspace(20.0, 600.0, 4000)


def frames_of(text, response, *, axis="u", black=10.0, gain=200.0, sequence=None):
    sequence = sequence or PatternSequence.parse(text, PANEL, axes=axis)
    size = sequence.size(axis)
    places = PLACES * (size / 640.0)
    frames = []
    for frame in sequence.frames():
        profile = frame.part.profile(frame.index, size)
        if frame.part.kind == "fringes":
            count = frame.part.fringe_count(PANEL)
            angle = 2.0 * np.pi * count * (places + 0.5) / size
            profile = 0.5 + 0.5 * np.cos(angle - frame.part.steps(size)[frame.index])
        elif isinstance(frame.part, PeriodicCode):
            turns = np.mod(frame.part.count * (places + 0.5) / size, 1.0)
            fine = replace(frame.part, count=1.0).profile(frame.index, 1 << 18)
            profile = np.interp(turns * (1 << 18) - 0.5, np.arange(1 << 18), fine)
        else:
            profile = profile[np.rint(places).astype(int)]
        frames.append(black + gain * response.light(np.clip(profile, 0.0, 1.0)))
    return np.array(frames)[:, np.newaxis], sequence, places


@pytest.mark.parametrize("name", RESPONSES)
@pytest.mark.parametrize(
    ("text", "axis"),
    [("gray+16@3", "u"), ("gray+16@4", "v"), ("1,4,16@5", "u"), ("gray+20@0/70/200/290", "u")],
)
def test_a_known_response_leaves_no_error(name, text, axis):
    response = RESPONSES[name]
    frames, sequence, places = frames_of(text, response, axis=axis)
    found = decode(frames, sequence, response=response, saturation=1e9).coordinate[axis][0]
    # Single precision of 200 DN: 1e-5 of 1/16 of the panel; linear between 4,096 places.
    assert np.max(np.abs(found - places)) < 2e-3
    if name != "linear" and text == "gray+16@3":
        bent = decode(frames, sequence, saturation=1e9).coordinate[axis][0]
        assert np.nanstd(bent - places) > 0.1


@pytest.mark.parametrize("name", RESPONSES)
@pytest.mark.parametrize(
    ("text", "axis"), [("gray+trapezoid8", "u"), ("gray+two-plus-one16", "v"), ("trapezoid1", "u")]
)
def test_a_known_response_leaves_no_error_of_codes_that_are_not_shifted_fringes(name, text, axis):
    response = RESPONSES[name]
    frames, sequence, places = frames_of(text, response, axis=axis)
    found = decode(frames, sequence, response=response, saturation=1e9).coordinate[axis][0]
    # As above, of an eighth of the panel or all of it: single precision of 200 DN and linear
    # between 4,096 places, of which a corner may be one.
    error = np.abs(found - places) / (640.0 if text == "trapezoid1" else 80.0)
    assert np.nanmax(error) < 5e-4
    assert np.isfinite(found).mean() > 0.99
    if name == "gamma 2.2":
        bent = decode(frames, sequence, saturation=1e9).coordinate[axis][0]
        assert np.nanstd(bent - places) > 0.1


def test_the_error_of_noise_is_that_of_a_linear_projector():
    rng = np.random.default_rng(0)
    response = Response(2.2)
    frames, sequence, places = frames_of("gray+16@5", response)
    noisy = frames + rng.normal(0.0, 1.0, frames.shape)
    noise = NoiseModel(read_dn=1.0, step_dn=0.0)
    found = decode(noisy, sequence, noise=noise, response=response, saturation=1e9)
    error = found.coordinate["u"][0] - places
    # 4,000 places: 1.1 % a standard error; the predicted deviation is of the mean modulation, and
    # the slope of the inverse is uneven over a fringe.
    assert np.std(error) == pytest.approx(np.sqrt(np.mean(found.sigma["u"] ** 2)), rel=0.25)
    assert abs(error.mean()) < 4 * error.std() / np.sqrt(error.size)


def test_saturated_pixels_stay_so_and_no_other_becomes_it():
    response = Response(2.2)
    frames, sequence, _ = frames_of("gray+16@4", response, gain=300.0)
    counts = np.minimum(np.rint(frames), 255).astype(np.uint8)
    straight = decode(counts, sequence, response=response).mask
    assert np.array_equal(straight, decode(counts, sequence).mask)


def test_too_steep_a_response_is_refused():
    with pytest.raises(InputError, match="two phases look alike"):
        decode(*frames_of("gray+16@3", Response(8.0))[:2], response=Response(8.0))


def test_codes_of_grey_are_refused_and_black_and_white_is_not():
    sequence = PatternSequence.parse("gray+modulated8@3", PANEL)
    frames = np.full((sequence.n_frames, 4, 4), 100.0)
    with pytest.raises(InputError, match="modulated"):
        decode(frames, sequence, response=Response(2.2))
    gray = PatternSequence.parse("gray", PANEL)
    decode(np.full((gray.n_frames, 4, 4), 100.0), gray, response=Response(2.2))


@pytest.mark.parametrize("name", RESPONSES)
def test_pictures_undo_a_response(name):
    sequence = PatternSequence.parse("1,8@4", (192, 120))
    response = RESPONSES[name]
    shown = np.array(list(pictures(sequence, bits=16, response=response))) / 65535.0
    # Half a level of 16 bit at black, by a gamma of 0.45, is (1 / 131,070)^0.45 = 0.005.
    np.testing.assert_allclose(response.light(shown), sequence.images(), atol=6e-3)


def test_a_curve_is_kept_with_its_capture(tmp_path):
    frames, sequence, places = frames_of("gray+16@4", S_CURVE)
    capture = Capture(frames.astype(np.float32), sequence, None, response=S_CURVE)
    capture.save(tmp_path / "one")
    again = Capture.load(tmp_path / "one")
    np.testing.assert_allclose(again.response.light(V), S_CURVE.light(V), atol=1e-6)
    assert np.nanmax(np.abs(again.decode().coordinate["u"][0] - places)) < 2e-3
    Capture(frames.astype(np.float32), sequence, None, response=Response(2.2)).save(tmp_path / "b")
    assert "response = 2.2" in (tmp_path / "b" / "capture.toml").read_text()


@pytest.mark.parametrize(
    ("rows", "said"),
    [
        ([[0.0, 0.0], [0.5, 0.2], [1.0, 0.1]], "radiances that grow"),
        ([[0.1, 0.0], [1.0, 1.0]], "values that grow from 0 to 1"),
    ],
)
def test_a_curve_that_is_none_is_refused_with_its_file(rows, said, tmp_path):
    write_table(tmp_path / "curve.csv", ("value", "radiance"), np.array(rows))
    with pytest.raises(InputError, match=said) as refused:
        Response.read(tmp_path / "curve.csv")
    assert "curve.csv" in str(refused.value)


def matched_frames(text, response, axis="u"):
    """Return noise-free frames of a code at whole panel places, (N, 1, P), and the places."""
    sequence = PatternSequence.parse(text, PANEL, axes=axis)
    size = sequence.size(axis)
    shown = np.array([f.part.profile(f.index, size) for f in sequence.frames()])
    places = np.arange(20, size - 20)
    return (
        (10.0 + 200.0 * response.light(np.clip(shown, 0.0, 1.0)))[:, None, places],
        sequence,
        places,
    )


@pytest.mark.parametrize("name", RESPONSES)
@pytest.mark.parametrize(
    ("text", "axis"),
    [("micro", "u"), ("hamiltonian6", "v"), ("speckle12", "u"), ("orders16@4+16@4", "u")],
)
def test_codes_are_matched_with_the_light_that_a_response_makes(name, text, axis):
    response = RESPONSES[name]
    frames, sequence, places = matched_frames(text, response, axis)
    noise = NoiseModel(read_dn=0.5, step_dn=0.0)
    options = {"noise": noise, "saturation": 1e9}
    found = decode(frames, sequence, response=response, **options)
    error = found.coordinate[axis][0] - places
    mask = found.mask[0]
    assert mask.mean() > 0.95
    # Without noise a place is the best of all, to single precision and what a parabola leaves.
    assert np.max(np.abs(error[mask])) < 0.05
    if name != "linear":
        bent = decode(frames, sequence, **options)
        wrong = ~(np.abs(bent.coordinate[axis][0] - places) < 0.05)
        assert wrong.mean() > 0.1


def test_pictures_over_the_whole_panel_are_matched_so_too():
    response = Response(2.2)
    shown = np.random.default_rng(1).integers(0, 256, (24, 48, 64), np.uint8)
    sequence = PatternSequence((64, 48), (Images(shown, "uv"),))
    frames = 10.0 + 200.0 * response.light(shown / 255.0)
    noise = NoiseModel(read_dn=0.5, step_dn=0.0)
    left = [
        decode(
            frames, sequence, noise=noise, saturation=1e9, response=own, keep_evidence=True
        ).evidence[0]["fit_residual_dn"]
        for own in (response, None)
    ]
    # The best place leaves nothing but single precision; without the response it leaves what is
    # no line of gamma: several DN.
    assert np.median(left[0]) < 0.01
    assert np.median(left[1]) > 1.0
