"""Expressions over the columns of an index: ``ra_um > 0.5 and kind in ('gear', 'coin')``.

A small part of Python's syntax, taken apart by Python's own parser and never evaluated by it:
comparisons of columns with numbers, texts, true and false or other columns, ``in`` with a
list, ``and``, ``or``, ``not``.  A sample that lacks a value (the parameters of another kind of
object) makes a comparison neither true nor false, as NULL does in SQL, so that neither
``teeth > 20`` nor ``not teeth > 20`` selects a coin.
"""

from __future__ import annotations

import ast
import operator
from collections.abc import Callable, Mapping
from typing import Any

from slbench.core.errors import InputError

Row = Mapping[str, Any]
#: True, False, or None where a value is missing.
Truth = Callable[[Row], bool | None]

_WHERE = "--where"
_FORM = "comparisons with <, <=, ==, !=, >=, >, in, joined by and, or, not"
#: No expression that a person writes is longer; the parser's depth is limited with it.
_LONGEST = 1000
_COMPARISONS: dict[type[ast.cmpop], Callable[[Any, Any], bool]] = {
    ast.Lt: operator.lt,
    ast.LtE: operator.le,
    ast.Eq: operator.eq,
    ast.NotEq: operator.ne,
    ast.GtE: operator.ge,
    ast.Gt: operator.gt,
    ast.In: lambda value, values: value in values,
    ast.NotIn: lambda value, values: value not in values,
}
#: What a column of an Arrow type is compared with.
_FAMILIES = {"string": "text", "bool": "true or false"}


def compile_where(expression: str, columns: Mapping[str, str]) -> Callable[[Row], bool]:
    """Turn an expression into a function that tells whether it holds for a row.

    Parameters
    ----------
    expression : str
    columns : mapping of str to str
        Names and Arrow types of the columns that it may use.

    Returns
    -------
    callable
        Row of the index to bool.

    Raises
    ------
    InputError
        If it is not of this form, names no column, or compares text with numbers.
    """
    if not isinstance(expression, str) or not 0 < len(expression) <= _LONGEST:
        raise InputError(_WHERE, f"{_FORM}, of up to {_LONGEST} characters", repr(expression)[:60])
    try:
        tree = ast.parse(expression.strip(), mode="eval")
        truth = _truth(tree.body, columns)
    except (SyntaxError, ValueError, RecursionError, MemoryError) as error:
        if isinstance(error, InputError):
            raise
        raise InputError(_WHERE, _FORM, repr(expression)) from None
    return lambda row: truth(row) is True


def _truth(node: ast.expr, columns: Mapping[str, str]) -> Truth:
    if isinstance(node, ast.BoolOp):
        terms = [_truth(value, columns) for value in node.values]
        decided = isinstance(node.op, ast.Or)  # one such term decides the whole

        def joined(row: Row) -> bool | None:
            values = [term(row) for term in terms]
            if decided in values:
                return decided
            return None if None in values else not decided

        return joined
    if isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.Not):
        inner = _truth(node.operand, columns)

        def negated(row: Row) -> bool | None:
            value = inner(row)
            return None if value is None else not value

        return negated
    if isinstance(node, ast.Compare):
        return _comparison(node, columns)
    raise InputError(_WHERE, _FORM, repr(ast.unparse(node)))


def _comparison(node: ast.Compare, columns: Mapping[str, str]) -> Truth:
    """Read a comparison or a chain of them, such as ``0.1 < ra_um <= 0.5``."""
    operands = [_operand(part, columns) for part in (node.left, *node.comparators)]
    operators = [_COMPARISONS.get(type(op)) for op in node.ops]
    text = repr(ast.unparse(node))
    for op, right in zip(node.ops, operands[1:], strict=True):
        if (right[2] == "list") != isinstance(op, ast.In | ast.NotIn):
            raise InputError(_WHERE, "a list after in, and only there", text)
    families = {family for _, family, _ in operands}
    if None in operators or len(families) != 1 or operands[0][2] == "list":
        if len(families) > 1:
            raise InputError(_WHERE, "text compared with text, numbers with numbers", text)
        raise InputError(_WHERE, _FORM, text)

    def holds(row: Row) -> bool | None:
        values = [value(row) for value, _, _ in operands]
        if None in values:
            return None
        pairs = zip(operators, values, values[1:], strict=False)
        return all(compare(left, right) for compare, left, right in pairs if compare)

    return holds


def _operand(node: ast.expr, columns: Mapping[str, str]) -> tuple[Callable[[Row], Any], str, str]:
    """Return how to get an operand's value, its family, and "column", "value" or "list"."""
    if isinstance(node, ast.Name):
        if node.id not in columns:
            raise InputError(_WHERE, f"one of the columns {', '.join(columns)}", repr(node.id))
        name = node.id
        return (lambda row: row.get(name)), _FAMILIES.get(columns[name], "number"), "column"
    if isinstance(node, ast.List | ast.Tuple):
        values = [_constant(item) for item in node.elts]
        families = {_family(value) for value in values}
        if len(families) != 1:
            raise InputError(_WHERE, "a list of numbers or of texts", repr(ast.unparse(node)))
        return (lambda row: values), families.pop(), "list"
    value = _constant(node)
    return (lambda row: value), _family(value), "value"


def _constant(node: ast.expr) -> Any:
    """Return the value of a number, text, true or false as written."""
    negative = isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.USub)
    inner = node.operand if isinstance(node, ast.UnaryOp) and negative else node
    value = inner.value if isinstance(inner, ast.Constant) else None
    if isinstance(value, int | float) and not isinstance(value, bool):
        return -value if negative else value
    if isinstance(value, str | bool) and not negative:
        return value
    raise InputError(_WHERE, "a column, a number or a text", repr(ast.unparse(node)))


def _family(value: Any) -> str:
    if isinstance(value, bool):
        return "true or false"
    return "text" if isinstance(value, str) else "number"
