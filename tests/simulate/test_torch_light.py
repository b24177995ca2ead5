"""Light and exposure in PyTorch: the project's own frames, and gradients by finite differences."""

from dataclasses import replace

import numpy as np
import pytest
import stages
from scenes_small import small, transport_of
from sparse_samples import sparse_rows

torch = pytest.importorskip("torch", reason="PyTorch (the extra `torch`) is not installed")

from slbench.core.errors import InputError, InputWarning  # noqa: E402
from slbench.detector.emva1288 import Detector  # noqa: E402
from slbench.scene.frame_errors import Drift  # noqa: E402
from slbench.simulate.expose import Shutter  # noqa: E402
from slbench.simulate.torch_exposure import TorchExposure, TorchPanel, torch_exposure  # noqa: E402
from slbench.simulate.transport import LightTransport  # noqa: E402

#: float32 has 24 bits; a sum of up to some 1000 positive terms in any order, through two products.
RTOL = 1000 * 2.0**-24
#: Asked of gradients against finite differences.
GRADIENT_RTOL = 1e-4
CUDA = pytest.param(
    "cuda", marks=pytest.mark.skipif(not torch.cuda.is_available(), reason="there is no CUDA GPU")
)
V, U, PANEL = 5, 7, (24, 10)


@pytest.fixture(scope="module")
def tiny():
    """Random light with all three marginals, on which dense matrices are small."""
    rng = np.random.default_rng(3)
    u, v = (rng.integers(0, n, (V * U, 12)) for n in PANEL)
    weights = rng.random((V * U, 12)).astype(np.float32)
    given = {
        "u": (u.astype(np.uint16), PANEL[0]),
        "v": (v.astype(np.uint16), PANEL[1]),
        "uv": ((v * PANEL[0] + u).astype(np.uint32), PANEL[0] * PANEL[1]),
    }
    marginals = {name: sparse_rows(c, weights, width) for name, (c, width) in given.items()}
    return LightTransport(marginals, rng.random((V, U)).astype(np.float32), PANEL, 12)


def panels(along, count=4, panel=PANEL, seed=1):
    width, height = panel
    shape = {"u": (width,), "v": (height,), "uv": (height, width)}[along]
    return np.random.default_rng(seed).random((count, *shape))


class TestProducts:
    @pytest.mark.parametrize("device", ["cpu", CUDA])
    @pytest.mark.parametrize("dense", [False, True])
    @pytest.mark.parametrize("along", ["u", "v", "uv"])
    def test_radiance_is_that_of_relight(self, tiny, along, dense, device):
        shown = panels(along)
        light = tiny.torch(along, dense=dense, device=device)
        seen = light(torch.tensor(shown, dtype=torch.float32, device=device)).cpu().numpy()
        np.testing.assert_allclose(seen, tiny.relight(shown, along), rtol=RTOL)

    def test_traced_light_with_footprints(self):
        transport = transport_of("step-block")
        assert transport.marginals["u"].blurred is not None  # else nothing is blurred here
        shown = panels("u", 6, transport.panel)
        wanted = transport.relight(shown, "u")
        seen = transport.torch()(torch.tensor(shown, dtype=torch.float32)).numpy()
        # Splines have weights of both signs between nodes: relative to the brightest.
        np.testing.assert_allclose(seen, wanted, rtol=RTOL, atol=RTOL * wanted.max())
        matrix = transport.to_scipy("u")
        assert matrix.shape == (wanted[0].size, transport.panel[0])
        product = np.maximum(matrix @ shown.T.astype(np.float32), 0.0).T.reshape(wanted.shape)
        np.testing.assert_allclose(
            product + transport.ambient, wanted, rtol=RTOL, atol=RTOL * wanted.max()
        )

    def test_chosen_pixels(self, tiny):
        shown = torch.tensor(panels("u"))
        pixels = np.array([30, 2, 2, 11])
        few = tiny.torch("u", pixels=pixels, dtype=torch.float64)(shown)
        whole = tiny.torch("u", dtype=torch.float64)(shown)
        assert few.shape == (4, 4)
        np.testing.assert_array_equal(few, whole.reshape(4, -1)[:, pixels])

    def test_scipy_has_all_marginals(self, tiny):
        for along in ("u", "v", "uv"):
            shown = panels(along).reshape(4, -1)
            seen = (tiny.to_scipy(along) @ shown.T).T.reshape(4, V, U) + tiny.ambient
            np.testing.assert_allclose(seen, tiny.relight(panels(along), along), rtol=RTOL)

    def test_refusals(self, tiny):
        with pytest.raises(InputError, match=r"shape \(K, 24\).*got \(4, 10\)"):
            tiny.torch("u")(torch.tensor(panels("v")))
        with pytest.raises(InputError, match="whole numbers from 0 to 34"):
            tiny.torch("u", pixels=[35])
        with pytest.raises(InputError, match=r"torch\.float32 or torch\.float64"):
            tiny.torch("u", dtype=torch.int32)
        only = replace(tiny, marginals={"u": tiny.marginals["u"]})
        for ask in (only.torch, only.to_scipy, only.factors):
            with pytest.raises(InputError, match="the 'v' marginal"):
                ask("v")


CURVE = ((0.0, 0.1), (0.3, 0.2), (0.7, 0.9), (1.0, 1.3))


def exposure_of(tiny, *, gamma=None, dense=False, along="u", device=None, **changes):
    """Return a scene's exposure of random light in double precision, which few pixels saturate."""
    rig = small("step-block").rig
    projector = replace(rig.projector, bit_depth=None, **changes)
    detector = Detector(bit_depth=12, full_well_e=9000.0, prnu=0.01, dsnu_e=3.0, offset_dn=100.0)
    light = tiny.torch(along, dense=dense, dtype=torch.float64, device=device)
    panel = TorchPanel(projector, gamma)
    # Light of up to some 8 W / (mm^2 sr) with the panel's.
    return TorchExposure(light, panel, detector, Shutter(2500.0, 0.02)).to(light.ambient.device)


def check_gradients(loss, parameters):
    """Hold gradients to central differences along random directions."""
    for one in parameters:
        one.grad = None
    loss().backward()
    rng = np.random.default_rng(0)
    for one in parameters:
        for _ in range(5):
            way = torch.tensor(rng.standard_normal(tuple(one.shape)), device=one.device)
            step = 1e-6
            with torch.no_grad():
                one += step * way
                above = loss()
                one -= 2 * step * way
                below = loss()
                one += step * way
            slope = float((above - below) / (2 * step))
            found = float((one.grad * way).sum())
            assert abs(found - slope) <= GRADIENT_RTOL * abs(slope), (found, slope)


class TestGradients:
    @pytest.mark.parametrize("device", ["cpu", CUDA])
    @pytest.mark.parametrize("dense", [False, True])
    @pytest.mark.parametrize("along", ["u", "v", "uv"])
    def test_of_noisy_frames(self, tiny, along, dense, device):
        """Patterns, exposure times and gamma, through noise that is drawn again alike."""
        gamma = torch.nn.Parameter(torch.tensor(1.8, dtype=torch.float64, device=device))
        exposure = exposure_of(tiny, gamma=gamma, dense=dense, along=along, device=device)
        # Off the ends of the range, where clipping has a corner.
        values = torch.tensor(0.1 + 0.8 * panels(along), device=device, requires_grad=True)
        times = torch.tensor([0.7, 0.9, 1.0, 0.8], dtype=torch.float64, device=device)
        times.requires_grad_()
        rng = np.random.default_rng(7)
        weights = torch.tensor(rng.standard_normal((4, V, U)), device=device)

        def loss():
            noise = torch.Generator(device or "cpu").manual_seed(5)
            frames = exposure(values, times, rounded=False, generator=noise)
            return (weights * frames).sum() + 1e-3 * (frames**2).sum()

        check_gradients(loss, [values, times, gamma])

    def test_of_a_measured_curve(self, tiny):
        exposure = exposure_of(tiny, curve=CURVE)
        values = torch.tensor(panels("u"), requires_grad=True)
        check_gradients(lambda: (exposure(values, noise=False, rounded=False) ** 2).sum(), [values])

    def test_of_traced_light(self):
        """Footprints, in single precision as stored, in a product of double precision."""
        transport = transport_of("step-block")
        light = transport.torch(
            pixels=np.arange(0, transport.ambient.size, 97), dtype=torch.float64
        )
        values = torch.tensor(panels("u", 3, transport.panel), requires_grad=True)
        scale = float(light(values).detach().max())
        check_gradients(lambda: ((light(values) / scale) ** 2).sum(), [values])

    def test_of_gradients(self, tiny):
        """Second derivatives, such as a Cramer-Rao bound's gradient needs."""
        light = tiny.torch(dtype=torch.float64)
        shown = torch.tensor(panels("u", 2), requires_grad=True)
        assert torch.autograd.gradgradcheck(lambda p: light(p) ** 2, (shown,), rtol=GRADIENT_RTOL)

    def test_rounding_is_passed_straight_through(self, tiny):
        rough = exposure_of(tiny)
        rough.panel.bit_depth = 3
        values = torch.tensor(panels("u"), requires_grad=True)
        rough(values, noise=False).sum().backward()
        found, values.grad = values.grad, None
        smooth = exposure_of(tiny)
        smooth(values, noise=False, rounded=False).sum().backward()
        # Linear but for the full well: the pixels that reach it are the same, by far.
        np.testing.assert_allclose(found, values.grad, rtol=1e-9)
        levels = np.unique(rough.panel(values).detach().numpy())
        np.testing.assert_allclose(levels * 7, np.arange(8), atol=1e-12)

    def test_saturated_pixels_and_dark_gamma_have_none(self, tiny):
        exposure = exposure_of(tiny, gamma=0.5)
        values = torch.tensor(panels("u"))
        values[:, :3] = 0.0
        values.requires_grad_()
        exposure(values, 1e3, rounded=False).sum().backward()
        np.testing.assert_array_equal(values.grad, 0.0)
        values.grad = None
        exposure(values, 0.3, noise=False).sum().backward()
        assert torch.isfinite(values.grad).all()
        np.testing.assert_array_equal(values.grad[:, :3], 0.0)
        assert (values.grad[:, 3:] > 0).any()


class TestExposure:
    @pytest.mark.parametrize("change", [{}, {"gamma": 2.2, "bit_depth": 6}, {"curve": CURVE}])
    def test_expected_frames_are_those_of_a_capture(self, change):
        scene = small("step-block", "1,10")
        rig = scene.rig
        scene = replace(scene, rig=rig.having(projector=replace(rig.projector, **change)))
        transport = transport_of("step-block")
        wanted = stages.capture(scene, transport, noise=False).frames
        parts = scene.rig.camera, scene.rig.projector, scene.detector, scene.exposure
        exposure = torch_exposure(transport, *parts, dtype=torch.float64)
        shown = scene.sequence.shown(np.arange(len(wanted)), "u")
        frames = exposure(torch.tensor(shown), noise=False).numpy()
        # Single precision beside double: a number that ends in a half is rounded either way.
        off = np.abs(frames - wanted)
        assert off.max() <= 1.0
        assert np.mean(off > 0) < 1e-3

    def test_noise_is_the_detectors(self):
        """Mean, deviation and fixed pattern of many exposures, beside those of the detector."""
        transport, scene = transport_of("step-block"), small("step-block", "white")
        scene = replace(scene, detector=replace(scene.detector, bit_depth=12, prnu=0.02))
        parts = scene.rig.camera, scene.rig.projector, scene.detector, scene.exposure
        exposure = torch_exposure(transport, *parts, dtype=torch.float64)
        values = torch.linspace(0.0, 1.0, 6, dtype=torch.float64)[:, None]  # levels of 8 bits
        values = values.expand(6, transport.panel[0])
        count = 400
        generator = torch.Generator().manual_seed(1)
        draws = np.stack([exposure(values, generator=generator).numpy() for _ in range(count)])
        radiance = transport.relight(values.numpy(), "u").astype(np.float64)
        own = np.random.default_rng(2)
        shutter = exposure.shutter
        theirs = np.stack(
            [
                scene.detector.expose(radiance, shutter.time_s, own, scale=shutter.photons)
                for _ in range(count)
            ]
        ).astype(float)
        clear = theirs.max(axis=0) < scene.detector.saturation_dn
        clear &= theirs.min(axis=0) > 0
        assert clear.mean() > 0.9
        variance = theirs.var(axis=0, ddof=1)
        # Each pixel's means differ by normal chance: 5.5 deviations for some 10^5 of them.
        z = (draws.mean(axis=0) - theirs.mean(axis=0)) / np.sqrt(2 * variance / count)
        assert np.abs(z[clear]).max() < 5.5
        assert abs(np.std(z[clear]) - 1.0) < 0.02
        # The ratio of pooled variances of N normal ones has a deviation of 2 / sqrt(N count).
        for k in range(6):
            known = clear[k]
            ratio = draws[:, k].var(axis=0, ddof=1)[known].mean() / variance[k][known].mean()
            assert abs(ratio - 1.0) < 5 * 2 / np.sqrt(known.sum() * count) + 1e-3
            with torch.no_grad():
                stated = exposure.variance(values[k : k + 1])[0].numpy()
            assert stated[known].mean() == pytest.approx(variance[k][known].mean(), rel=0.01)

    def test_exposure_of_each_frame(self, tiny):
        exposure = exposure_of(tiny)
        values = torch.tensor(panels("u", 2))
        both = exposure.electrons(values, torch.tensor([0.5, 2.0]))
        np.testing.assert_allclose(both[0], exposure.electrons(values, 0.5)[0], rtol=1e-12)
        np.testing.assert_allclose(both[1], exposure.electrons(values, 2.0)[1], rtol=1e-12)

    def test_chosen_pixels_have_their_own_pattern(self, tiny):
        scene, pixels = small("step-block"), np.array([3, 17])
        parts = scene.rig.camera, scene.rig.projector, scene.detector, scene.exposure
        few = torch_exposure(tiny, *parts, pixels=pixels)
        whole = torch_exposure(tiny, *parts)
        np.testing.assert_array_equal(few.response, whole.response.reshape(-1)[pixels])
        values = torch.tensor(panels("u"), dtype=torch.float32)
        frames = few(values, noise=False)
        np.testing.assert_array_equal(frames, whole(values, noise=False).reshape(4, -1)[:, pixels])

    def test_frame_errors_are_said_to_be_left_out(self, tiny):
        scene = small("step-block")
        exposure = replace(scene.exposure, drift=Drift(change=-0.5, pictures=2.0))
        parts = scene.rig.camera, scene.rig.projector, scene.detector
        with pytest.warns(InputWarning, match="exposure: .*drift are left out"):
            drifting = torch_exposure(tiny, *parts, exposure)
        values = torch.tensor(panels("u"), dtype=torch.float32)
        steady = torch_exposure(tiny, *parts, scene.exposure)
        np.testing.assert_array_equal(drifting(values, noise=False), steady(values, noise=False))

    def test_another_detector_is_refused(self, tiny):
        scene = small("step-block")
        parts = scene.rig.camera, scene.rig.projector, object(), scene.exposure
        with pytest.raises(InputError, match="emva1288"):
            torch_exposure(tiny, *parts, shutter=Shutter(1.0, 1.0))
