"""Design methods: what a rig should look like, found by search.

:mod:`~slbench.design.multisearch` is a general multi-objective solver,
:mod:`~slbench.design.front` holds what it finds and measures how good it is, and
:mod:`~slbench.design.clustering` reduces a front to a few distinct designs: these three know
functions and boxes only, nothing of structured light.
"""
