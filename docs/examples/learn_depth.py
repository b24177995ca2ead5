"""Learn fringe orders from three frames of eight fringes, without unwrapping frames.

    slbench dataset make docs/examples/learn.toml --out learn --count 48
    python docs/examples/learn_depth.py learn

A wrapped phase repeats every fringe.  Which fringe a pixel sees takes further frames, or a
network that knows where surfaces can be before one rig: it gets three grey values and the
pixel's place.  Baseline: each place's most frequent order in the training set.
"""

import sys

import numpy as np
import torch

from slbench import datasets
from slbench.datasets.read.torch_adaptor import CaptureDataset, loader

FRINGES, PIXELS, EPOCHS, WIDTH = 8, 2000, 30, 128
PATTERNS = f"{FRINGES}@3"


def pixels(sample, shots):
    """Return values (n, 5), orders (n,) and places (n, 2) of pixels that the projector lights."""
    lit = np.argwhere(sample.truth.lit)
    places = np.random.default_rng(int(shots.frames.sum())).choice(lit, PIXELS)
    v, u = places.T
    values = np.column_stack((shots.frames[:, v, u].T / 255, places / shots.frames.shape[1:]))
    order = (sample.truth.panel[v, u, 0] + 0.5) * FRINGES / shots.sequence.panel[0]
    return values.astype(np.float32), order.clip(0, FRINGES - 1).astype(np.int64), places


def baseline(train, test):
    """Return the share of right orders when each place (4 x 4 pixels) has one order."""
    counts = np.zeros((*(n // 4 + 1 for n in train[0].transport.shape), FRINGES))
    for sample in train:
        _, orders, places = pixels(sample, sample.capture(PATTERNS))
        np.add.at(counts, (*places.T // 4, orders), 1)
    guess = counts.argmax(axis=-1)
    return np.mean([guess[*places.T // 4] == orders for _, orders, places in test])


def main(path):
    """Train, test, and return the shares of right orders of baseline and network."""
    torch.manual_seed(0)
    train, test = datasets.open_dataset(path).split(train=0.75, test=0.25, seed=0).values()
    captures = CaptureDataset(train, PATTERNS, item=pixels, keep=len(train))
    unseen = [CaptureDataset(test, PATTERNS, item=pixels, seed=1)[k] for k in range(len(test))]
    linear, relu = torch.nn.Linear, torch.nn.ReLU
    layers = (linear(5, WIDTH), relu(), linear(WIDTH, WIDTH), relu(), linear(WIDTH, WIDTH), relu())
    network = torch.nn.Sequential(*layers, linear(WIDTH, FRINGES))
    optimiser = torch.optim.Adam(network.parameters(), lr=3e-3)
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimiser, EPOCHS)
    for epoch in range(EPOCHS):
        captures.set_epoch(epoch)  # other noise, other pixels
        for values, orders, _ in loader(captures, batch_size=2, shuffle=True):
            loss = torch.nn.functional.cross_entropy(network(values).mT, orders)
            optimiser.zero_grad()
            loss.backward()
            optimiser.step()
        schedule.step()
    with torch.no_grad():
        right = [network(torch.tensor(x)).argmax(1).numpy() == orders for x, orders, _ in unseen]
    return baseline(train, unseen), np.mean(right)


if __name__ == "__main__":
    print("right orders: baseline {:.1%}, network {:.1%}".format(*main(sys.argv[1])))
