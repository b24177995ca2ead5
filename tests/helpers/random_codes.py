"""Random codes of every registered family, from the types of their fields; random sequences."""

from functools import cache
from types import UnionType
from typing import Any, Literal, Union, get_args, get_origin

import annotated_types as at
import numpy as np
from hypothesis import reject
from hypothesis import strategies as st

from slbench.core.errors import InputError
from slbench.core.validation.wording import base_of, metadata_of
from slbench.patterns import Code, PatternSequence, pattern_codes
from slbench.patterns.images import Images

#: Of every sequence; small, so that pictures are.
PANEL = (96, 64)
#: Numbers beyond are of no use on such a panel.
_MOST, _LONGEST = 40, 5


def values_of(hint: Any) -> st.SearchStrategy[Any]:
    """Return a strategy for the values that a field's type takes."""
    if get_origin(hint) in (Union, UnionType):
        return st.one_of(*map(values_of, get_args(hint)))
    base = base_of(hint)
    marks = [
        mark
        for one in metadata_of(hint)
        for mark in (one if isinstance(one, at.Interval) else [one])
    ]
    if base is type(None):
        return st.none()
    if base is bool:
        return st.booleans()
    if get_origin(base) is Literal:
        return st.sampled_from(get_args(base))
    if get_origin(base) is tuple:
        least = max([m.min_length for m in marks if isinstance(m, at.MinLen)], default=0)
        inner = values_of(get_args(base)[0])
        return st.lists(inner, min_size=least, max_size=_LONGEST).map(tuple)
    above = max([m.gt for m in marks if isinstance(m, at.Gt)], default=None)
    low = max([m.ge for m in marks if isinstance(m, at.Ge)], default=-_MOST)
    high = min([m.le for m in marks if isinstance(m, at.Le)], default=_MOST)
    low = max(low, -_MOST) if above is None else above
    high = min(high, max(low + 1, _MOST))
    if base is int:
        return st.integers(int(low), int(high))
    numbers = st.floats(low, high, exclude_min=above is not None)
    whole = [n for n in range(int(np.ceil(low)), int(high) + 1) if n != above]
    return st.one_of(st.sampled_from(whole).map(float), numbers) if whole else numbers


def pictures() -> st.SearchStrategy[Any]:
    """Return a strategy for the pictures of a code."""
    shape = st.tuples(st.integers(1, 4), st.just(PANEL[1]), st.just(PANEL[0]))
    kinds = st.sampled_from([np.uint8, np.uint16])
    seeds = st.integers(0, 2**32 - 1)
    return st.builds(
        lambda kind, shape, seed: np.random.default_rng(seed).integers(0, 255, shape).astype(kind),
        *(kinds, shape, seeds),
    )


@cache
def fields_of(family: type[Code]) -> dict[str, st.SearchStrategy[Any]]:
    """Return strategies for the fields of a family."""
    if family is Images:
        blurs = st.sampled_from([0.0, 0.75, 1.25])
        coded = st.sampled_from(["u", "v", "uv"])
        return {"pictures": pictures(), "coded": coded, "blur_px": blurs}
    return {name: values_of(hint) for name, hint in family.fields_of().items()}


@st.composite
def codes(draw: st.DrawFn, kind: str | None = None, without: tuple[str, ...] = ()) -> Code:
    """Draw a code that the panel can show, of any family unless one is named.

    Fields named in `without` keep their defaults.
    """
    # Families that other tests have added are not the package's.
    own = [name for name in pattern_codes.names() if pattern_codes.origin(name) == "slbench"]
    family = pattern_codes.get(draw(st.sampled_from(own)) if kind is None else kind)
    for _ in range(20):
        some = {
            name: one
            for name, one in fields_of(family).items()
            if name not in without and draw(st.booleans())
        }
        try:
            code = family(**{name: draw(one) for name, one in some.items()})
            PatternSequence(PANEL, (code,))
        except (InputError, TypeError):  # fields that do not go together, or one that is required
            continue
        return code
    reject()


@st.composite
def sequences(draw: st.DrawFn, kind: str | None = None) -> PatternSequence:
    """Draw a sequence of up to four codes, one of a family that may be named."""
    parts = [draw(codes(kind)), *draw(st.lists(codes(), max_size=3))]
    order = draw(st.permutations(range(len(parts))))
    beside = {
        "unwrap": draw(values_of(PatternSequence.fields_of()["unwrap"])),
        "max_order_residual": draw(values_of(PatternSequence.fields_of()["max_order_residual"])),
    }
    for count in range(len(parts), 0, -1):  # some do not go together
        try:
            return PatternSequence(PANEL, tuple(parts[k] for k in order if k < count), **beside)
        except InputError:
            continue
    raise AssertionError("a single code that is a sequence")
