"""Expressions over the columns of an index: ``ra_um > 0.5 and kind in ('gear', 'coin')``.

A small part of Python's syntax, taken apart by Python's own parser and computed by Arrow, column
by column: comparisons of columns with numbers, texts, true and false or other columns, ``in``
with a list, ``and``, ``or``, ``not``.  A sample that lacks a value (the parameters of another
kind of object) makes a comparison neither true nor false, as NULL does in SQL (Kleene's logic),
so that neither ``teeth > 20`` nor ``not teeth > 20`` selects a coin.
"""

from __future__ import annotations

import ast
import functools
import itertools
from collections.abc import Mapping, Sequence
from typing import Any

from slbench.core.errors import InputError
from slbench.core.extras import extra

Row = Mapping[str, Any]

_WHERE = "--where"
_FORM = "comparisons with <, <=, ==, !=, >=, >, in, joined by and, or, not"
#: No expression that a person writes is longer; the parser's depth is limited with it.
_LONGEST = 1000
#: Arrow's functions.
_COMPARISONS: Mapping[type[ast.cmpop], str] = {
    ast.Lt: "less",
    ast.LtE: "less_equal",
    ast.Eq: "equal",
    ast.NotEq: "not_equal",
    ast.GtE: "greater_equal",
    ast.Gt: "greater",
}


def rows_where(expression: str, rows: Sequence[Row], columns: Mapping[str, str]) -> list[bool]:
    """Return for which rows of an index an expression holds.

    Parameters
    ----------
    expression : str
    rows : sequence of mappings
    columns : mapping of str to str
        Names and Arrow types of the columns that it may use.

    Raises
    ------
    InputError
        If it is not of this form, names no column, or compares text with numbers.
    """
    if not isinstance(expression, str) or not 0 < len(expression) <= _LONGEST:
        raise InputError(_WHERE, f"{_FORM}, of up to {_LONGEST} characters", repr(expression)[:60])
    arrow = extra("pyarrow")
    try:
        tree = ast.parse(expression.strip(), mode="eval")
        holds = _Rows(rows, columns).holds(tree.body)
    except InputError:
        raise
    except arrow.ArrowNotImplementedError:  # no such comparison of these types
        expected = "text compared with text, numbers with numbers"
        raise InputError(_WHERE, expected, repr(expression)) from None
    except (SyntaxError, ValueError, OverflowError, RecursionError, MemoryError):
        raise InputError(_WHERE, _FORM, repr(expression)) from None
    if isinstance(holds, arrow.Scalar):
        raise InputError(_WHERE, "a column of the index", repr(expression))
    return [value is True for value in holds.to_pylist()]


class _Rows:
    """Rows that expressions are computed over, column by column."""

    def __init__(self, rows: Sequence[Row], columns: Mapping[str, str]) -> None:
        self._rows, self._columns = rows, columns
        self._arrow, self._compute = extra("pyarrow"), extra("pyarrow.compute")

    def holds(self, node: ast.expr) -> Any:
        """Return whether a condition holds, (rows,) of true, false or null."""
        match node:
            case ast.BoolOp(op, values):
                join = "and_kleene" if isinstance(op, ast.And) else "or_kleene"
                return self._joined(join, [self.holds(value) for value in values])
            case ast.UnaryOp(ast.Not(), operand):
                return self._compute.invert(self.holds(operand))
            case ast.Compare(left, ops, comparators):
                sides = itertools.pairwise([left, *comparators])  # a chain: 0.1 < ra_um <= 0.5
                steps = [self._compared(a, op, b) for op, (a, b) in zip(ops, sides, strict=True)]
                return self._joined("and_kleene", steps)
        raise InputError(_WHERE, _FORM, repr(ast.unparse(node)))

    def _compared(self, left: ast.expr, op: ast.cmpop, right: ast.expr) -> Any:
        value = self._operand(left)
        if isinstance(op, ast.In | ast.NotIn):
            if not isinstance(right, ast.Tuple | ast.List) or not right.elts:
                raise InputError(_WHERE, "a list after in", repr(ast.unparse(right)))
            equal = [self._compute.equal(value, self._operand(item)) for item in right.elts]
            found = self._joined("or_kleene", equal)
            return found if isinstance(op, ast.In) else self._compute.invert(found)
        if type(op) not in _COMPARISONS:
            raise InputError(_WHERE, _FORM, repr(ast.unparse(ast.Compare(left, [op], [right]))))
        return getattr(self._compute, _COMPARISONS[type(op)])(value, self._operand(right))

    def _joined(self, join: str, conditions: Sequence[Any]) -> Any:
        return functools.reduce(getattr(self._compute, join), conditions)

    def _operand(self, node: ast.expr) -> Any:
        """Return a column, or the value of a number, text, true or false as written."""
        if isinstance(node, ast.Name):
            if node.id not in self._columns:
                expected = f"one of the columns {', '.join(self._columns)}"
                raise InputError(_WHERE, expected, repr(node.id))
            kind = self._arrow.type_for_alias(self._columns[node.id])
            return self._arrow.array([row.get(node.id) for row in self._rows], kind)
        value = ast.literal_eval(node)
        if not isinstance(value, bool | int | float | str):
            raise InputError(_WHERE, "a column, a number or a text", repr(ast.unparse(node)))
        return value
