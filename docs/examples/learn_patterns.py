"""Learn six patterns on stored light, and hold them to fringes on scenes that they have not seen.

    slbench dataset make docs/examples/patterns.toml --out patterns --count 24
    python docs/examples/learn_patterns.py patterns

Patterns are sums of waves whose amplitudes are parameters.  A step exposes them on the light of a
scene, through panel, lens and detector with its noise, and asks how far off the matching decoder
is, and how probably it takes another column for a pixel's own.  To learn for another decoder, or
for exposure times, write another loss: `exposure(values, times)` has gradients for all of it.
"""

import sys
from pathlib import Path

import numpy as np
import torch

from slbench import datasets
from slbench.bench.compare.compare import compare
from slbench.bench.compare.sets import PatternSet
from slbench.core.io import write_toml
from slbench.design.learned.objective import Lit, loss, worth
from slbench.design.learned.waves import Waves
from slbench.patterns import PatternSequence
from slbench.patterns.images import Images

FRAMES, CYCLES, STEPS, PIXELS = 6, 80, 2500, 320
FRINGES = "1,48@3"


def light(sample):
    """Return the exposure of smooth pixels of a sample, and the columns that they truly see."""
    smooth = np.flatnonzero(sample.truth.smooth())
    pixels = np.random.default_rng(sample.seed).permutation(smooth)[:2000]
    return Lit(sample.torch(pixels=pixels), sample.truth.panel[..., 0].ravel()[pixels])


def learned(lights, width, steps):
    """Return values in [0, 1] of patterns (FRAMES, width) after a descent on the light."""
    code, noise = Waves(FRAMES, CYCLES, width, seed=0), torch.Generator().manual_seed(0)
    optimiser = torch.optim.Adam([code.weights], lr=0.03, betas=(0.9, 0.99))
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimiser, steps)
    for step in range(steps):
        lit = lights[step % len(lights)]
        seen = torch.randint(len(lit.places), (PIXELS,), generator=noise)
        found = worth(code, lit, seen, bound=False, generator=noise)
        value = loss(found)
        optimiser.zero_grad()
        value.backward()
        optimiser.step()
        schedule.step()
        if step % 250 == 0:
            deviation, lost = found.deviation.detach().median(), found.lost.detach().mean()
            print(f"step {step}: {deviation:.4f} px, {lost:.2%} of the pixels lost")
    with torch.no_grad():
        return code.at(code.series(torch.arange(float(width))), code.range()).numpy().T


def main(path, steps=STEPS, out=None):
    """Learn on three quarters of the objects; return the pairs of errors on the others."""
    torch.set_num_threads(1)
    train, test = datasets.open_dataset(path).split(train=0.75, test=0.25, seed=0).values()
    width, height = train[0].transport.panel
    values = learned([light(sample) for sample in train], width, steps)
    pictures = np.rint(values * 65535).astype(np.uint16)[:, None].repeat(height, axis=1)
    patterns = PatternSequence((width, height), (Images(pictures, "u"),))
    if out is not None:  # for `slbench scan SCENE --patterns OUT`, `compare`, `patterns write`
        Path(out).mkdir()
        write_toml(Path(out) / "patterns.toml", {"patterns": patterns.to_dict(Path(out))})
    pairs = []
    for sample in test:
        light_of = {"transports": [sample.transport], "truth": sample.truth}
        sets = [PatternSet("learned", patterns), FRINGES]
        result = compare(sample.scene, sets, repeats=5, equal="photons", **light_of)
        (pair,) = result.error_pairs
        pairs.append(pair if pair.a == "learned" else pair.reversed())
        share = {one.name: f"{one.right:.2%}" for one in result.sets}
        interval = "{:.3f} to {:.3f}".format(*pairs[-1].ratio_ci95)
        print(f"sample {sample.number}: error / {FRINGES}'s {interval}; measured rightly {share}")
    return pairs


if __name__ == "__main__":
    main(*sys.argv[1:2], out=sys.argv[2] if len(sys.argv) > 2 else None)
