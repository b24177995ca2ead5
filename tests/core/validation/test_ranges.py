"""Every number from people has a range: finite alone is not enough, 1e308 squared is not."""

import importlib
import inspect
import pkgutil
from typing import get_args

import pytest
from annotated_types import Ge, Gt, Interval, Le, Lt
from pydantic import BaseModel

import slbench
from slbench.cli import SECTIONS
from slbench.cli.lazy import Group
from slbench.core.registry import resolved
from slbench.core.validation.values import Value
from slbench.core.validation.wording import base_of, metadata_of, table_fields

#: Compared with the one number that is right, or infinite by default.
EXEMPT = {"format", "version", "focus_distance_mm"}


def all_modules():
    for module in pkgutil.walk_packages(slbench.__path__, "slbench."):
        if not module.name.endswith("__main__"):
            try:
                importlib.import_module(module.name)
            except ImportError as error:  # an extra that is not installed
                assert "slbench" not in str(error)  # noqa: PT017


def subclasses(cls):
    for sub in cls.__subclasses__():
        yield sub
        yield from subclasses(sub)


def bounds(hint):
    low = high = False
    for mark in metadata_of(hint):
        for part in mark if isinstance(mark, Interval) else [mark]:
            low |= isinstance(part, Ge | Gt)
            high |= isinstance(part, Le | Lt)
    return low, high


def numbers(hint, place):
    base = base_of(hint)
    if base in (int, float):
        yield place, bounds(hint)
    else:
        for argument in get_args(base):
            if argument is not type(None):
                yield from numbers(argument, f"{place}[]")


def test_every_number_of_every_table_and_value_has_both_ends():
    all_modules()
    checked, open_ended = 0, []
    for cls in {*subclasses(Value), *subclasses(BaseModel)}:
        if not cls.__module__.startswith("slbench."):
            continue
        for name, hint in table_fields(cls).items():
            for place, ends in numbers(hint, name):
                checked += 1
                if ends != (True, True) and name not in EXEMPT:
                    open_ended.append(f"{cls.__module__}.{cls.__name__}.{place}")
    assert checked > 200
    assert open_ended == []


def commands():
    rows = {name: row for part in SECTIONS.values() for name, row in part.items()}
    for name, row in rows.items():
        found = resolved(row)
        if isinstance(found, Group):
            for inner, command in found.commands.items():
                yield f"{name} {inner}", command
        else:
            yield name, found


@pytest.mark.parametrize(("name", "command"), commands(), ids=lambda x: x if type(x) is str else "")
def test_every_number_of_the_command_line_has_both_ends(name, command):
    hints = inspect.get_annotations(inspect.unwrap(command.callback), eval_str=True)
    for option, hint in hints.items():
        for place, ends in numbers(hint, option):
            assert ends == (True, True), f"{name}: {place}"


@pytest.mark.parametrize("text", ["2147483648", "99999999999999999999", "-1", "1e308", "nan", "0"])
def test_a_panel_has_a_width(text):
    from scenes_small import check_refused, run_cli

    check_refused(
        run_cli("design", "patterns", "--width-px", text, "--noise-rad", "0.03"), "--width-px"
    )


@pytest.mark.parametrize(
    ("command", "option"),
    [
        (["scan", "step-block"], "--spp"),
        (["scan", "step-block"], "--steps"),
        (["scan", "step-block"], "--seed"),
        (["compare", "step-block", "--set", "1,2"], "--repeats"),
        (["dataset", "make", "mixed", "--out", "o", "--count", "2"], "--workers"),
        (["dataset", "make", "mixed", "--out", "o"], "--count"),
        (["design", "rig", "hardware/macro-ch6"], "--evaluations"),
        (["design", "rig", "hardware/macro-ch6"], "--max-footprint-mm"),
        (["design", "verify", "hardware/macro-ch6"], "--count"),
        (["design", "noise", "ch8-stack"], "--heights"),
        (["calibrate", "run", "ch8-grid-stack"], "--z-steps"),
        (["register", "a.ply", "b.ply", "--positions", "c.csv"], "--voxel-um"),
        (["decode", "folder"], "--min-modulation"),
        (["fuse", "folder", "--out", "a.png"], "--window"),
    ],
)
@pytest.mark.parametrize("text", ["99999999999999999999", "1e308", "-1", "nan", "inf", "x", ""])
def test_sizes_are_refused_before_any_work(command, option, text, tmp_path, monkeypatch):
    from scenes_small import check_refused, run_cli

    monkeypatch.chdir(tmp_path)
    check_refused(run_cli(*command, option, text), option)
    assert list(tmp_path.iterdir()) == []
