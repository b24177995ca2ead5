"""One sample of a data set: its parts loaded on first use, its light under any patterns.

A sample's bytes are one range of its shard, read, checked against their SHA-256 and unpacked
when a part of it is first asked for.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import cached_property, partial
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from slbench.capture.capture import MANIFEST as CAPTURE
from slbench.capture.capture import Capture
from slbench.core.errors import InputError
from slbench.core.io import read_json
from slbench.core.io.images import read_grey
from slbench.core.show.display import brief
from slbench.core.validation.types import Seed
from slbench.core.validation.values import checked
from slbench.datasets.store import sample, shards
from slbench.datasets.store.storage import Storage
from slbench.detector.base import DetectorModel
from slbench.patterns import PatternSource, read_patterns
from slbench.rig import Rig
from slbench.rig.opencv import read_rig
from slbench.scene.file import load_scene, load_settings
from slbench.scene.model import Exposure, Scene
from slbench.scene.truth import GroundTruth
from slbench.simulate.expose import Shutter, capture, shutter_for
from slbench.simulate.torch_exposure import TorchExposure, torch_exposure
from slbench.simulate.transport import LightTransport, Marginal

T = TypeVar("T")
Row = Mapping[str, Any]


@dataclass(frozen=True, eq=False)
class Sample:
    """One sample; every part is loaded on first use and kept.

    Parameters
    ----------
    storage : Storage
    row : mapping of str to value
        Its row of the index.
    drawn : tuple of str
        The columns that hold what was drawn.
    verify : bool
        Whether its bytes are checked against the SHA-256 of the index.
    allow_modules : bool
        Whether the Python modules that it names may be run.
    """

    storage: Storage
    row: Row
    drawn: tuple[str, ...]
    verify: bool = True
    allow_modules: bool = False

    __repr__ = brief

    @property
    def number(self) -> int:
        """Its index in the data set as made, failed samples counted."""
        return int(self.row["sample"])

    @property
    def seed(self) -> int:
        """Seed of its light and first capture: a scan of its scene with it is this sample."""
        return int(self.row["seed"])

    @property
    def where(self) -> str:
        """Shard and key, for messages."""
        return f"{self.storage.where(self.row['shard'])}: sample {self.row['key']}"

    @property
    def parameters(self) -> dict[str, Any]:
        """What was drawn for it, with the object's ``kind``; nothing that it does not have."""
        values = {name: self.row[name] for name in ("kind", *self.drawn)}
        return {name: value for name, value in values.items() if value is not None}

    @cached_property
    def members(self) -> Mapping[str, bytes]:
        """The files of the sample by name (:mod:`slbench.datasets.store.sample`).

        Raises
        ------
        InputError
            If the shard is missing or truncated, or the bytes are not those of the index.
        """
        size = int(self.row["size"])
        content = self.storage.read_range(self.row["shard"], int(self.row["offset"]), size)
        if len(content) != size:
            expected = f"{size} bytes from byte {self.row['offset']}"
            raise InputError(self.where, expected, f"{len(content)}, the shard ends there")
        if self.verify and (found := shards.digest(content)) != self.row["sha256"]:
            raise InputError(self.where, f"SHA-256 {self.row['sha256']}", found)
        return sample.unpack(self.number, content, self.where)

    @cached_property
    def transport(self) -> LightTransport:
        """Its light transport."""
        content = self.member(sample.TRANSPORT)
        with self._blamed(sample.TRANSPORT):
            return LightTransport.load(sample.TRANSPORT, content)

    @cached_property
    def truth(self) -> GroundTruth:
        """Its ground truth."""
        return self._read(sample.TRUTH, partial(GroundTruth.load, rig=self.rig))

    @property
    def instances(self) -> NDArray[Any]:
        """Instance mask (V, U) uint16: 0 where no object is, k + 1 for the scene's object k."""
        if sample.INSTANCES in self.members:
            return self._read(sample.INSTANCES, read_grey).astype(np.uint16)
        return self.truth.instances

    @cached_property
    def rig(self) -> Rig:
        """Camera and projector."""
        return self._read(sample.RIG, read_rig)

    @cached_property
    def scene(self) -> Scene:
        """The scene with its objects, whose meshes are built or taken from the cache."""
        load = partial(load_scene, allow_modules=self.allow_modules)
        return self._read(sample.SCENE, load, beside=True)

    @cached_property
    def score(self) -> dict[str, Any]:
        """Statistics, and under ``captures`` the score of each stored capture."""
        return self._read(sample.SCORE, read_json)

    @cached_property
    def captures(self) -> tuple[str, ...]:
        """Names of the stored captures: ``p0r0`` is pattern set 0, repeat 0."""
        return tuple(sample.capture_names(self.members))

    def stored(self, name: str | None = None) -> Capture:
        """Return a stored capture.

        Parameters
        ----------
        name : str, optional
            One of :attr:`captures`, by default the first.

        Raises
        ------
        InputError
            If it is not there; a data set may hold light transport alone.
        """
        if not self.captures or (name is not None and name not in self.captures):
            known = ", ".join(self.captures) or "none (Sample.capture makes any)"
            raise InputError(f"{self.where}: capture", f"one that is stored: {known}", name)
        prefix = self.captures[0] if name is None else name
        load = partial(Capture.load, allow_modules=self.allow_modules)
        return self._read(f"{prefix}.{CAPTURE}", load, beside=True)

    @cached_property
    def frames(self) -> NDArray[Any]:
        """Frames of the first stored capture, (N, V, U) uint8 or uint16."""
        return self.stored().frames

    @checked
    def capture(
        self,
        sequence: PatternSource,
        detector: DetectorModel | None = None,
        seed: Seed = 0,
        noise: bool = True,
        *,
        exposure: Exposure | None = None,
        gamma: float | None = None,
    ) -> Capture:
        """Expose frames of any patterns from the stored light transport.

        They are the frames of a fresh scan with the same patterns, detector and seeds, bit for
        bit, unless the data set was made with rounded weights.

        Parameters
        ----------
        sequence : PatternSequence, str and whatever else is a pattern set
            Text such as ``"1,10,50@4"`` codes the panel's columns; a file, a folder of pictures or
            ``module:object`` (:func:`slbench.patterns.read_patterns`), where modules may be run.
        detector : DetectorModel, optional
            The scene's by default.
        seed : int
            Of temporal noise and vibration.
        noise : bool
            False: the expected frames, rounded once.
        exposure : Exposure, optional
            The scene's by default, whose lost triggers may lie beyond the end of shorter patterns.
        gamma : float, optional
            Of the panel, the scene's by default.

        Returns
        -------
        Capture

        Raises
        ------
        InputError
            For patterns that the panel or the stored marginals cannot show, a seed that is no
            whole number from 0, or a scene in which nothing is lit.
        """
        shown = read_patterns(
            sequence, self.transport.panel, allow_modules=self.allow_modules
        ).sequence
        scene, rig = self._settings, self._settings.rig
        pictures = -(-shown.n_frames // shown.channels)
        if gamma is not None:
            rig = rig.having(projector=replace(rig.projector, gamma=gamma, curve=None))
        return capture(
            self.transport,
            shown,
            rig,
            detector or scene.detector,
            exposure or scene.exposure.of_pictures(pictures),
            seed=seed,
            noise=noise,
            shutter=self._shutter if detector is None and exposure is None else None,
        )

    def torch(self, along: Marginal = "u", **options: Any) -> TorchExposure:
        """Return its exposure as a PyTorch module, ``frames = exposure(values)``, with gradients.

        Vibration and frame errors are left out; of the latter there is a warning.

        Parameters
        ----------
        along : {"u", "v", "uv"}
        **options
            Of :func:`slbench.simulate.torch_exposure.torch_exposure`.

        Raises
        ------
        InputError
            If PyTorch is not installed, or the light has no such marginal.
        """
        scene = self._settings
        parts = scene.rig.camera, scene.rig.projector, scene.detector, scene.exposure
        options = {"shutter": self._shutter} | options
        return torch_exposure(self.transport, *parts, along=along, **options)

    def ready(self) -> Sample:
        """Load what :meth:`capture` needs, and return the sample: for :meth:`Dataset.ahead`."""
        _ = self.transport, self._settings, self._shutter
        return self

    @cached_property
    def _settings(self) -> Scene:
        """The scene without its objects: all that an exposure from transport needs."""
        modules = [name for name in self.members if name.startswith(f"{sample.MODULE}.")]
        kept = {name: self.member(name) for name in (sample.SCENE, sample.RIG, *modules)}
        with self._blamed(sample.SCENE), sample.unpacked(kept) as folder:
            return load_settings(folder / sample.SCENE, allow_modules=self.allow_modules)

    @cached_property
    def _shutter(self) -> Shutter:
        """The shutter for the scene's own detector."""
        scene = self._settings
        return shutter_for(self.transport, scene.rig.camera, scene.detector, scene.exposure)

    def member(self, name: str) -> bytes:
        """Return the content of one of the sample's files.

        Raises
        ------
        InputError
            If the sample has no such file.
        """
        if name not in self.members:
            raise InputError(f"{self.where}: {name}", "this file in the shard", "none")
        return self.members[name]

    def _read(self, name: str, load: Callable[[Path], T], beside: bool = False) -> T:
        """Load a file with the package's own reader, other files beside it where it needs them."""
        wanted = {name: self.member(name)}
        with self._blamed(name), sample.unpacked(self.members if beside else wanted) as folder:
            return load(folder / name)

    @contextmanager
    def _blamed(self, name: str) -> Iterator[None]:
        """Let an error name the sample and its file, not where that was unpacked."""
        try:
            yield
        except InputError as error:
            raise InputError(f"{self.where}: {name}", error.expected, error.got) from None
