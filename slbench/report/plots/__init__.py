"""Figures, drawn with matplotlib; which function draws what.

A value that has a picture asks :mod:`slbench.core.drawing` for it, which finds the row of its
type here: the value does not import how it is drawn.
"""

#: Type of the value -> function that draws it into a matplotlib figure, by dotted names.
DRAWERS: dict[str, str] = {
    "slbench.simulate.scan:Scan": "slbench.report.plots.scan:summary",
    "slbench.bench.compare.comparison:Comparison": "slbench.report.pages.compare:draw",
}
