"""Parts of a data set that have no object in common.

A network that has seen a gear under one pose has seen the gear: samples of one object belong
to one part, or the test measures memory.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from slbench.core.errors import InputError
from slbench.core.random import generator
from slbench.core.validation.types import Fraction, Seed
from slbench.core.validation.values import checked

#: Fractions such as 0.7 + 0.2 + 0.1 may exceed 1 by rounding.
_ROUNDING = 1e-9


@checked
def by_object(
    objects: Sequence[str], fractions: Mapping[str, Fraction], seed: Seed = 0
) -> dict[str, list[int]]:
    """Deal samples out to parts, all samples of an object to one part.

    Objects are dealt in random order, those of many samples first, each to the part that
    lacks most of its share; so parts have their shares as nearly as whole objects allow.

    Parameters
    ----------
    objects : (n,) sequence of str
        What identifies each sample's object.
    fractions : mapping of str to float
        Share of the samples by name of the part.
    seed : int

    Returns
    -------
    dict of str to list of int
        Positions of each part's samples, ascending.

    Raises
    ------
    InputError
        If a fraction is not positive, they sum to more than 1, a part stays empty, or the
        seed is no whole number from 0.
    """
    if not fractions:
        raise InputError("split", "parts such as train=0.8, test=0.2", "none")
    total = sum(fractions.values())
    if total > 1 + _ROUNDING:
        raise InputError("split", "fractions that sum to 1 at most", f"{total:g}")
    members: dict[str, list[int]] = {}
    for position, name in enumerate(objects):
        members.setdefault(name, []).append(position)
    names = sorted(members)  # whatever order the samples stand in
    order = [names[k] for k in generator(seed).permutation(len(names))]
    order.sort(key=lambda name: -len(members[name]))

    lacking: dict[str | None, float] = {k: s * len(objects) for k, s in fractions.items()}
    if total < 1 - _ROUNDING:  # what is left over is a part like the others
        lacking[None] = (1 - total) * len(objects)
    parts: dict[str | None, list[int]] = {name: [] for name in lacking}
    for name in order:
        part = max(lacking, key=lambda k: lacking[k])
        parts[part] += members[name]
        lacking[part] -= len(members[name])
    for name in fractions:
        if not parts[name]:
            got = f"{len(names)} objects in {len(objects)} samples"
            raise InputError(f"split: {name}", "objects enough that every part has one", got)
    return {name: sorted(parts[name]) for name in fractions}
