"""Learning a code: the descent, and what comes out as a pattern set."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Annotated, Literal

import numpy as np
from numpy.typing import NDArray

from slbench.core.errors import InputError
from slbench.core.extras import extra
from slbench.core.show.display import brief
from slbench.core.validation.types import Interval, LearningSteps, Seed
from slbench.core.validation.values import checked
from slbench.design.learned.objective import Lit, Worth, loss, worth
from slbench.design.learned.waves import Bits, Waves
from slbench.patterns import PatternSequence
from slbench.patterns.images import Images
from slbench.scene.model import Scene
from slbench.scene.truth import GroundTruth
from slbench.simulate.torch_exposure import torch_exposure
from slbench.simulate.transport import LightTransport

Against = Literal["matching", "bound"]
LearnedFrames = Annotated[int, Interval(ge=4, le=64)]

#: Pixels of a scene that are learned on, and of one step.
_PIXELS, _STEP_PIXELS = 2000, 320
#: Random starts, and the share of the steps after which the best of them goes on alone.
_STARTS, _TRIED = 3, 0.1
#: First rate of the descent (Adam; D. P. Kingma, J. Ba, ICLR 2015).
_RATE = 0.03
#: Contrast that the finest waves keep in the middling pixel, and panel pixels that they need.
_CONTRAST, _LEAST_PX = 0.35, 6.0
#: Contrast from which on its fall tells the blur, and the least blur that binary codes need, px:
#: less leaves steps from column to column that the decoder takes for edges.
_CLEAR, _LEAST_BLUR = 0.1, 0.75


@dataclass(frozen=True, eq=False)
class LearnedCode:
    """A code that was learned.

    Parameters
    ----------
    values : (K, W) float64
        Pattern values in [0, 1] along the panel's first axis.
    count : int
        Highest number of cycles across the panel.
    deviation_px : float
        Median deviation that the decoder is predicted to have on the light that was learned on, px.
    lost : float
        Mean probability there that a pixel is placed wrongly, or masked as ambiguous.
    blur_px : float
        Of binary codes: standard deviation of the blur that the decoder knows them by, px.
    """

    values: NDArray[np.float64]
    count: int
    deviation_px: float
    lost: float
    blur_px: float = 0.0

    __repr__ = brief

    def sequence(self, height: int) -> PatternSequence:
        """Return the pattern set for a panel of that height: pictures of 16 bits, binary of 8."""
        depth = np.uint8 if self.blur_px else np.uint16
        rows = np.rint(self.values * np.iinfo(depth).max).astype(depth)
        pictures = np.repeat(rows[:, np.newaxis], height, axis=1)
        images = Images(pictures, "u", "learned_*.png", self.blur_px)
        return PatternSequence((rows.shape[1], height), (images,))


def lit_of(
    scene: Scene, transport: LightTransport, truth: GroundTruth, seed: int = 0
) -> Lit | None:
    """Return a scene's light to learn on: some of its smooth lit pixels; None for too few.

    Raises
    ------
    InputError
        If PyTorch is not installed, or the detector has no model of its noise for it.
    """
    smooth = np.flatnonzero(truth.smooth())
    if len(smooth) < _STEP_PIXELS:
        return None
    random = np.random.default_rng(seed)
    pixels = np.sort(random.choice(smooth, min(_PIXELS, len(smooth)), replace=False))
    parts = scene.rig.camera, scene.rig.projector, scene.detector, scene.exposure
    exposure = torch_exposure(transport, *parts, pixels=pixels)
    return Lit(exposure, truth.panel[..., 0].ravel()[pixels])


def finest(lights: Sequence[Lit]) -> int:
    """Return the highest number of cycles whose contrast lens and camera keep.

    That of the median pixel, worst scene, is 0.35 of a coarse fringe's at least.
    """
    counts, kept = _contrasts(lights)
    good = counts[kept.min(axis=0) >= _CONTRAST]
    return int(good.max(initial=counts[0]))


def softness(lights: Sequence[Lit]) -> float:
    """Return the standard deviation of the blur of lens and camera, panel px.

    A Gaussian's, by how the contrast of the median pixel falls with the number of cycles n across
    W pixels, ``ln c = a - 2 (pi blur n / W)^2``: light that comes indirectly, which takes the
    same from all of them, is in a.  Mean over the scenes.
    """
    size = lights[0].exposure.light.panel[0]
    counts, kept = _contrasts(lights)
    falls = []
    for row in kept:
        clear = row >= _CLEAR
        x = 2.0 * (np.pi * counts[clear] / size) ** 2
        falls.append(-np.polyfit(x, np.log(row[clear]), 1)[0] if clear.sum() > 1 else np.nan)
    square = float(np.nanmean(falls)) if np.isfinite(falls).any() else 0.0
    return float(np.sqrt(max(square, 0.0)))


def _contrasts(lights: Sequence[Lit]) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Return numbers of cycles and the contrast that the median pixel of each scene has of them."""
    torch = extra("torch", "torch")
    size = lights[0].exposure.light.panel[0]
    places = 2.0 * np.pi * (torch.arange(size) + 0.5) / size
    counts = np.unique(np.geomspace(2.0, size / _LEAST_PX, 24).astype(int))
    kept = np.zeros((len(lights), len(counts)))
    for row, lit in zip(kept, lights, strict=True):
        light = lit.exposure.light
        white = light(torch.ones(1, size)) - light.ambient
        for k, n in enumerate(counts.tolist()):
            waves = 0.5 + 0.5 * torch.stack((torch.cos(n * places), torch.sin(n * places)))
            parts = light(waves) - light.ambient - 0.5 * white
            row[k] = float((2.0 * parts.norm(dim=0) / white[0]).median())
    return counts, kept


@checked
def learn(
    lights: Sequence[Lit],
    frames: LearnedFrames,
    *,
    count: int | None = None,
    binary: bool = False,
    against: Against = "matching",
    steps: LearningSteps = 3000,
    seed: Seed = 0,
    on_progress: Callable[[float], None] | None = None,
) -> LearnedCode:
    """Learn a code on the light of scenes by gradients.

    Of three random starts the one that is best after a tenth of the steps goes on.  A binary code's
    columns are on or off; its decoder knows the blur of lens and panel (:func:`softness`).

    Parameters
    ----------
    lights : sequence of Lit
        Of one panel.
    frames : int
        4 to 64.
    count : int, optional
        Highest number of cycles across the panel; by default what lens and camera pass
        (:func:`finest`).  A binary code begins with it, and is not held to it.
    binary : bool
    against : {"matching", "bound"}
        What is made least beside lost pixels: the matching decoder's error, or the Cramer-Rao
        bound.
    steps : int
    seed : int
    on_progress : callable, optional
        Called with the finished fraction.

    Returns
    -------
    LearnedCode

    Raises
    ------
    InputError
        For no light, light of other panels, arguments out of range, or a binary code where the lens
        is too sharp for one.
    """
    torch = extra("torch", "torch")
    sizes = {lit.exposure.light.panel for lit in lights}
    if len(sizes) != 1:
        raise InputError("learn: lights", "light of one panel", f"{len(sizes)} panels")
    ((size,),) = sizes
    count = finest(lights) if count is None else count
    if not 1 <= count <= size / 4:
        raise InputError("learn: count", f"1 to {size // 4} cycles", count)
    blur = softness(lights) if binary else 0.0
    if binary and blur < _LEAST_BLUR:
        expected = f"a blur of {_LEAST_BLUR} panel pixels at least, to tell places between columns"
        raise InputError("learn: binary", expected, f"{blur:.2f} px on this light")

    def begun(start: int) -> Waves | Bits:
        if binary:
            return Bits(frames, count, size, start, blur)
        return Waves(frames, count, size, start)

    threads = torch.get_num_threads()
    torch.set_num_threads(1)  # tensors as small as these gain nothing from more
    try:
        descents = [
            _Descent(lights, begun(start), against, steps, start)
            for start in range(seed * _STARTS, (seed + 1) * _STARTS)
        ]
        tried = int(_TRIED * steps)
        done, total = 0, steps + (_STARTS - 1) * tried

        def go_on(one: _Descent, until: int) -> None:
            nonlocal done
            while one.step < until:
                one.go_on()
                done += 1
                if on_progress and done % 10 == 0:
                    on_progress(done / total)

        for one in descents:
            go_on(one, tried)
        best = min(descents, key=lambda one: one.recent)
        go_on(best, steps)
        with torch.no_grad():
            found = [best.worth(lit, torch.arange(len(lit.places))) for lit in lights]
            shown = best.code.profiles().shown
    finally:
        torch.set_num_threads(threads)
    return LearnedCode(
        shown.numpy().T.astype(np.float64),
        count,
        float(np.median([float(one.deviation.median()) for one in found])),
        float(np.mean([float(one.lost.mean()) for one in found])),
        blur,
    )


class _Descent:
    """One start on its way down."""

    def __init__(
        self, lights: Sequence[Lit], code: Waves | Bits, against: Against, steps: int, seed: int
    ) -> None:
        torch = extra("torch", "torch")
        self.lights, self.code, self.against, self.step = lights, code, against, 0
        self.optimiser = torch.optim.Adam([code.weights], lr=_RATE, betas=(0.9, 0.99))
        self.schedule = torch.optim.lr_scheduler.CosineAnnealingLR(self.optimiser, steps)
        self.generator = torch.Generator().manual_seed(seed)
        self.recent = 0.0

    def worth(self, lit: Lit, seen: object) -> Worth:
        return worth(self.code, lit, seen, self.against == "bound", self.generator)

    def go_on(self) -> None:
        """Take a step on one of the scenes."""
        torch = extra("torch", "torch")
        lit = self.lights[self.step % len(self.lights)]
        seen = torch.randint(len(lit.places), (_STEP_PIXELS,), generator=self.generator)
        value = loss(self.worth(lit, seen))
        self.optimiser.zero_grad()
        value.backward()
        self.optimiser.step()
        self.schedule.step()
        self.step += 1
        self.recent = float(value.detach()) if self.step == 1 else self.recent
        self.recent += 0.1 * (float(value.detach()) - self.recent)
