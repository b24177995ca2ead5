"""Random streams: the one place where a seed becomes generators and further seeds.

Every draw comes from a seed and the *words* or *tags* that say what it is for.  There are two
ways from them to numbers:

- **Words** (:func:`generator`, :func:`derived_seed`) are appended to the seed.  Frames, light
  and samples of data sets are drawn so, and stay as they are: a seed is part of what people
  have stored.  NumPy fills up with zeros, so that a last word of zero is the same as none:
  ``generator(7, 0)`` equals ``generator(7)``.  Streams that must differ therefore differ in a
  word other than zero: one of :class:`Word`.
- **Tags** (:func:`tagged_seed`) are NumPy's spawn keys, which are not filled up: every run of
  tags has a stream of its own.  Use these for anything new.

(M. E. O'Neill's mixing as in NumPy's ``SeedSequence``; streams of different entropy are
independent for all that tests can tell.)
"""

from __future__ import annotations

from enum import IntEnum

import numpy as np


class Word(IntEnum):
    """What a stream of a scan or an experiment is for."""

    NOISE = 1
    VIBRATION = 2
    STAGE = 3
    POSITION = 4


def generator(seed: int, *words: int) -> np.random.Generator:
    """Return the generator of a seed and words; a last word of zero is the same as none."""
    return np.random.default_rng([seed, *words] if words else seed)


def derived_seed(seed: int, *words: int) -> int:
    """Return a further seed of 32 bits; a last word of zero is the same as none."""
    return int(np.random.SeedSequence([seed, *words]).generate_state(1)[0])


def setting_seed(seed: int, setting: int | None) -> int:
    """Return the seed of the frames of one focus setting; of a single picture for none.

    A setting has noise of its own, whatever the seeds of other scans; a single picture has the
    scan's seed.
    """
    return seed if setting is None else derived_seed(seed, setting)


def tagged_seed(seed: int, *tags: int) -> int:
    """Return a seed of its own for each run of tags, so that no two random streams are shared.

    Examples
    --------
    >>> tagged_seed(7) != tagged_seed(7, 0) != tagged_seed(7, 0, 0)
    True
    """
    return int(np.random.SeedSequence(seed, spawn_key=tags).generate_state(1)[0])
