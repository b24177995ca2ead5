"""Design methods: what a rig should look like, found by search.

:mod:`~slbench.design.search.multisearch` is a general multi-objective solver,
:mod:`~slbench.design.search.front` holds what it finds and measures how good it is, and
:mod:`~slbench.design.search.clustering` reduces a front to a few distinct designs: these three know
functions and boxes only, nothing of structured light.

Fringe sequences: :mod:`~slbench.design.fringes.noise` estimates the phase noise,
:mod:`~slbench.design.fringes.unwrapping` has one unwrapping step in closed form,
:mod:`~slbench.design.fringes.chain` a whole sequence, :mod:`~slbench.design.fringes.design` the
thesis's criterion and predictions, :mod:`~slbench.design.fringes.bounded` the criterion with a
bound on order errors; :mod:`~slbench.simulate.repeats` and :mod:`~slbench.design.fringes.trial` put
designs to the test on simulated scans, :mod:`~slbench.design.fringes.characterise` maps the noise
through a volume, and :mod:`~slbench.report.plots.fringe_design` draws.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
