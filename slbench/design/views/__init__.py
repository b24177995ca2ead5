"""Viewpoint planning: which poses of a part a scanner has to measure it in.

:mod:`~slbench.design.views.candidates` has the poses that a stage can take up,
:mod:`~slbench.design.views.predict` what each of them measures,
:mod:`~slbench.design.views.cover` the choice among them, and
:mod:`~slbench.design.views.plan` the whole.
"""
