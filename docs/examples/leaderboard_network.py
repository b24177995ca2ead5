"""Enter the leaderboard with a small network a task, which corrects the closed form.

    slbench leaderboard make board --preview
    slbench dataset make leaderboard-1 --seed 1 --count 60 --preview --out training
    python docs/examples/leaderboard_network.py board training small-unet --minutes 10
    slbench leaderboard score board small-unet --baseline closed-form

It begins as the closed form with gaps filled by their neighbours, and learns what is to be added:
a U-Net of three scales (some 55,000 weights) that sees the closed form, the pictures and the rig's
expectation of the stage.  Phases and orders are learned in turns, so that geometry stays exact.
"""

import argparse
import time
from pathlib import Path

import numpy as np
import torch
from torch import nn
from torch.nn import functional

from slbench import datasets
from slbench.leaderboard.baselines import filled, reference_turns, turns_of_one
from slbench.leaderboard.board import open_board
from slbench.leaderboard.scenes import FRINGES, TURN, Scene, depth_of
from slbench.leaderboard.tasks import TASKS, absolute_turns

CROP, BATCH, WIDTH = 128, 4, 16
MM = 10.0  # of the unit in which depths are learned


class UNet(nn.Module):
    """Three scales; the last layer begins at zero, and so does the correction."""

    def __init__(self, channels):
        super().__init__()
        sizes = [WIDTH, 2 * WIDTH, 2 * WIDTH]
        self.down = nn.ModuleList(map(self.block, [channels, *sizes], sizes))
        self.up = nn.ModuleList([self.block(4 * WIDTH, WIDTH), self.block(2 * WIDTH, WIDTH)])
        self.last = nn.Conv2d(WIDTH, 1, 1)
        nn.init.zeros_(self.last.weight)
        nn.init.zeros_(self.last.bias)

    @staticmethod
    def block(before, after):
        """Return two layers."""

        def layer(n):
            return nn.Sequential(
                nn.Conv2d(n, after, 3, padding=1, padding_mode="replicate"),
                nn.GroupNorm(4, after),
                nn.ReLU(),
            )

        return nn.Sequential(layer(before), layer(after))

    def forward(self, x):
        """Return the correction (n, V, U) of what is seen (n, C, V, U)."""
        one = self.down[0](x)
        two = self.down[1](functional.avg_pool2d(one, 2))
        low = self.down[2](functional.avg_pool2d(two, 2))
        for skip, block in ((two, self.up[0]), (one, self.up[1])):
            low = functional.interpolate(low, skip.shape[-2:], mode="bilinear")
            low = block(torch.cat((low, skip), 1))
        return self.last(low)[:, 0]


def prepared(scene, task):
    """Return what the network sees (C, V, U), the closed form and what is right (V, U).

    The last two are in the unit that is learned: turns, or 10 mm; NaN where nothing is asked for.
    """
    stage = reference_turns(scene.rig, scene.shape, scene.panel_width)
    used = scene.frames[list(TASKS[task].frames)].astype(float)
    light = max(float(used.max()), 1.0)
    asked = np.isfinite(TASKS[task].target(scene))
    if task == "completion":
        start, right, known = scene.decoded_depth, scene.truth.depth, stage
        scale, centre = MM, np.nanmedian(start)
    else:
        right, scale, centre = absolute_turns(scene), 1.0, 0.0
        if task == "phase":
            start = scene.phase / TURN
            right = start + np.mod(right - start + 0.5, 1.0) - 0.5
        elif task == "depth-1":
            start = turns_of_one(scene)
        else:
            start = (scene.shots.decode().coordinate["u"] + 0.5) * FRINGES / scene.panel_width
        known = stage
    missing = np.isnan(start)
    start = filled(start)
    wave = [turn(TURN * start) for turn in (np.cos, np.sin)] if task != "completion" else []
    seen = start - known if task in ("depth-1", "depth-6", "orders") else (start - centre) / scale
    if task == "phase":
        seen = np.mod(start - known, 1.0)
    modulation = np.log(used.std(axis=0) + 1.0) if len(used) > 1 else used[0] / 255.0
    channels = [seen, missing, *wave, modulation, *(used / light)]
    right = np.where(asked, right, np.nan)
    return np.stack(channels).astype(np.float32), start / scale, right / scale


def predicted(scene, task, network):
    """Return the network's map of a task, in its unit."""
    x, start, _ = prepared(scene, task)
    v, u = scene.shape
    padding = (0, -u % 4, 0, -v % 4)
    with torch.no_grad():
        shown = functional.pad(torch.from_numpy(x)[None], padding, mode="replicate")
        map_ = start + network(shown)[0, :v, :u].double().numpy()
    if task == "completion":
        return map_ * MM
    if task == "phase":
        return np.mod(map_, 1.0) * TURN
    if task == "orders":
        return np.rint(map_ - scene.phase / TURN)
    return depth_of(scene.rig, map_ * scene.panel_width / FRINGES - 0.5)


def train(scenes, task, minutes, seed=0):
    """Return a network that was trained for so many minutes of a processor, and its losses."""
    torch.manual_seed(seed)
    draw = np.random.default_rng(seed)
    given = [prepared(scene, task) for scene in scenes]
    network = UNet(len(given[0][0]))
    optimiser = torch.optim.Adam(network.parameters(), lr=3e-3)
    begin, losses = time.process_time(), []
    while (share := (time.process_time() - begin) / (60.0 * minutes)) < 1.0:
        for group in optimiser.param_groups:
            group["lr"] = 3e-3 * 0.5 * (1.0 + np.cos(np.pi * share)) + 1e-5
        crops = []
        for k in draw.integers(len(given), size=BATCH):
            x, start, right = given[k]
            v, u = (int(draw.integers(max(n - CROP, 0) + 1)) for n in start.shape)
            place = np.s_[v : v + CROP, u : u + CROP]
            crops.append((x[:, *place], (right - start)[place]))
        shown, wanted = (np.stack(part) for part in zip(*crops, strict=True))
        wanted = torch.from_numpy(wanted.astype(np.float32))
        asked = wanted.isfinite()
        if not asked.any():
            continue
        loss = (network(torch.from_numpy(shown)) - wanted)[asked].abs().mean()
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
        losses.append(loss.item())
    return network.eval(), losses


def main():
    """Train a network a task, and write what it predicts."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("board")
    parser.add_argument("training")
    parser.add_argument("out", type=Path)
    parser.add_argument("--minutes", type=float, default=10.0)
    parser.add_argument("--tasks", nargs="+", default=list(TASKS), choices=TASKS)
    options = parser.parse_args()
    board = open_board(options.board)
    scenes = [Scene(sample) for sample in datasets.open_dataset(options.training)]
    for task in options.tasks:
        network, losses = train(scenes, task, options.minutes)
        weights = sum(weight.numel() for weight in network.parameters())
        last = np.mean(losses[-100:])
        print(f"{task}: {weights} weights, {len(losses)} steps, loss {last:.4f}", flush=True)
        (options.out / task).mkdir(parents=True, exist_ok=True)
        for scene in board:
            map_ = predicted(scene, task, network).astype(np.float32)
            np.save(options.out / task / f"{scene.key}.npy", map_)


if __name__ == "__main__":
    main()
