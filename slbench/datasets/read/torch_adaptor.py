"""A data set for PyTorch: patterns and noise put on stored light as samples are drawn.

:class:`CaptureDataset` is map-style, :class:`CaptureStream` iterable; :func:`loader` makes a
``DataLoader`` whose workers start safely.  What a sample looks like in an epoch follows from
(seed, epoch, sample) alone: the same whichever number of workers draws it, other noise in
every epoch.  Call ``set_epoch`` before each, as for PyTorch's ``DistributedSampler``; workers
that live on see it too.

Nothing is open between samples, each read opens its shard for its range, so processes share no
file handle.  Needs the extra ``torch``.
"""

from __future__ import annotations

import os
from collections import OrderedDict
from collections.abc import Callable, Iterator
from typing import Any

import numba
import numpy as np

from slbench.capture.capture import Capture
from slbench.core.errors import InputError
from slbench.core.extras import extra
from slbench.core.random import generator
from slbench.core.validation.types import Whole
from slbench.core.validation.values import checked
from slbench.datasets.read.reader import Dataset
from slbench.datasets.read.recipe import Chooser, Patterns, Recipe
from slbench.datasets.read.stored import Sample
from slbench.detector.base import DetectorModel

try:
    # DataLoader tells an iterable data set by its class, so the base is needed here.
    from torch.utils.data import IterableDataset as _Iterable
except ImportError:  # said when one is made, not when this module is read
    _Iterable = object

Item = Callable[[Sample, Capture], Any]

#: The process that has been found safe to run compiled loops in.
_checked_process: int | None = None


def tensors(sample: Sample, shots: Capture) -> dict[str, Any]:
    """Return what most networks are trained on; NaN, where there is no surface, becomes 0.

    Parameters
    ----------
    sample : Sample
    shots : Capture

    Returns
    -------
    dict
        ``frames`` (N, V, U) float32 in [0, 1], ``depth`` (V, U) float32 in mm, ``panel``
        (2, V, U) float32 in projector pixels, ``lit`` (V, U) bool: where all are defined and
        the projector's light arrives, ``instances`` (V, U) int32: 0 where no object is, k + 1 for
        object k of the scene, and ``sample``, its number.
    """
    torch = _torch()
    truth = sample.truth
    panel = np.nan_to_num(np.moveaxis(truth.panel, -1, 0)).astype(np.float32)
    return {
        "frames": torch.from_numpy(shots.frames.astype(np.float32) / (2**shots.depth - 1)),
        "depth": torch.from_numpy(np.nan_to_num(truth.depth).astype(np.float32)),
        "panel": torch.from_numpy(panel),
        "lit": torch.from_numpy(truth.lit),
        "instances": torch.from_numpy(truth.instances.astype(np.int32)),
        "sample": sample.number,
    }


class _Captures:
    """Samples of a data set under a recipe, in an epoch that all processes share."""

    @checked
    def __init__(
        self,
        data: Dataset,
        patterns: Patterns | Chooser | None,
        *,
        detector: DetectorModel | None = None,
        noise: bool = True,
        seed: int = 0,
        item: Item = tensors,
        keep: Whole = 0,
    ) -> None:
        self.data = data
        self.recipe = Recipe(patterns, detector, noise, seed)
        self.item = item
        self.keep = keep
        self._kept: OrderedDict[int, Sample] = OrderedDict()
        # In shared memory: a copy sent to a worker sees what is set here afterwards.
        self._epoch = _torch().zeros(1, dtype=_torch().int64).share_memory_()

    @checked
    def set_epoch(self, epoch: Whole) -> None:
        """Choose the epoch, in all workers too; call it before iterating."""
        self._epoch[0] = epoch

    @property
    def epoch(self) -> int:
        """The epoch that is drawn."""
        return int(self._epoch[0])

    def __len__(self) -> int:
        return len(self.data)

    def __getstate__(self) -> dict[str, Any]:
        """Return what a worker needs: it keeps samples of its own."""
        return self.__dict__ | {"_kept": OrderedDict()}

    def _make(self, position: int, epoch: int) -> Any:
        _check_process()
        sample = self._sample(position)
        return self.item(sample, self.recipe.shots(sample, epoch))

    def _sample(self, position: int) -> Sample:
        """Return a sample, with what has been loaded of it where it is kept."""
        sample = self._kept.pop(position, None) or self.data[position]
        if self.keep:
            self._kept[position] = sample
            if len(self._kept) > self.keep:
                self._kept.popitem(last=False)
        return sample


class CaptureDataset(_Captures):
    """Map-style: ``dataset[k]`` is sample k under the recipe.

    Parameters
    ----------
    data : Dataset
        As :func:`slbench.datasets.open_dataset` or a selection of it gives.
    patterns : str, PatternSequence, callable or None
        See :class:`slbench.datasets.read.recipe.Recipe`.
    detector : DetectorModel, optional
    noise : bool
    seed : int
    item : callable
        Turns a sample and its capture into what the loader collates; see :func:`tensors`.
    keep : int
        Samples each process keeps in memory once loaded: about 40 MB each at 640 x 480.

    Raises
    ------
    InputError
        If PyTorch is not installed or an argument is out of range.
    """

    def __getitem__(self, position: int) -> Any:
        if not -len(self) <= position < len(self):
            raise IndexError(position)
        return self._make(position % len(self), self.epoch)


class CaptureStream(_Captures, _Iterable):  # type: ignore[misc]
    """Iterable: every sample once an epoch, shared out among the workers.

    Worker w of n draws samples w, w + n, ... of the epoch's order, so that each is drawn once,
    and without batches in the same order whatever n is.

    Parameters
    ----------
    data, patterns, **options
        As for :class:`CaptureDataset`.
    shuffle : bool
        A new order every epoch.
    """

    def __init__(
        self,
        data: Dataset,
        patterns: Patterns | Chooser | None,
        *,
        shuffle: bool = True,
        **options: Any,
    ) -> None:
        super().__init__(data, patterns, **options)
        self.shuffle = shuffle

    def __iter__(self) -> Iterator[Any]:
        order, epoch = np.arange(len(self)), self.epoch
        if self.shuffle:
            # Another stream than the noise's, which has the sample's number too.
            order = generator(self.recipe.seed, epoch).permutation(order)
        worker = _torch().utils.data.get_worker_info()
        first, step = (0, 1) if worker is None else (worker.id, worker.num_workers)
        for position in order[first::step]:
            yield self._make(int(position), epoch)


def loader(captures: CaptureDataset | CaptureStream, **options: Any) -> Any:
    """Return a ``torch.utils.data.DataLoader`` whose workers start afresh.

    A forked worker inherits the threads of compiled loops that its parent has run, and is
    killed by the OpenMP library at the first one of its own; so workers are not forked.  As
    for all such processes, the script that makes them guards its start with
    ``if __name__ == "__main__":``.

    Parameters
    ----------
    captures : CaptureDataset or CaptureStream
    **options
        Of ``DataLoader``; with workers, ``multiprocessing_context`` is ``"forkserver"`` (or
        ``"spawn"``) and ``persistent_workers`` is True by default.
    """
    torch = _torch()
    if options.get("num_workers", 0) > 0:
        methods = torch.multiprocessing.get_all_start_methods()
        start = "forkserver" if "forkserver" in methods else "spawn"
        options = {"multiprocessing_context": start, "persistent_workers": True} | options
    return torch.utils.data.DataLoader(captures, **options)


def _torch() -> Any:
    return extra("torch", "torch")


def _check_process() -> None:
    """Refuse to run in a forked worker that the OpenMP library would kill without a word."""
    global _checked_process
    if _checked_process == os.getpid():
        return
    if _torch().utils.data.get_worker_info() is not None:
        try:
            inherited = numba.threading_layer() == "omp"
        except ValueError:  # no compiled loop has run: nothing is inherited
            inherited = False
        if inherited:
            expected = "workers that are not forked (slbench.datasets.read.torch_adaptor.loader)"
            raise InputError("DataLoader", expected, "a fork of a process with OpenMP threads")
    _checked_process = os.getpid()
