"""Design methods: what a rig should look like, found by search.

:mod:`~slbench.design.multisearch` is a general multi-objective solver,
:mod:`~slbench.design.front` holds what it finds and measures how good it is, and
:mod:`~slbench.design.clustering` reduces a front to a few distinct designs: these three know
functions and boxes only, nothing of structured light.

Fringe sequences: :mod:`~slbench.design.noise` estimates the phase noise,
:mod:`~slbench.design.unwrapping` has one unwrapping step in closed form,
:mod:`~slbench.design.chain` a whole sequence, :mod:`~slbench.design.fringes` the thesis's criterion
and predictions, :mod:`~slbench.design.bounded` the criterion with a bound on order errors;
:mod:`~slbench.design.repeats` and :mod:`~slbench.design.trial` put designs to the test on simulated
scans, :mod:`~slbench.design.characterise` maps the noise through a volume, and
:mod:`~slbench.design.fringe_figures` draws.
"""
