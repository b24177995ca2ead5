"""Fringes: sets of shifted sinusoids, their relative phase, and what resolves its ambiguity.

``code`` says what a set shows, ``weights`` how its frames are weighed, ``ways`` what tells the
fringes apart, ``decode`` hands it all to the compiled loop.
"""

from slbench.patterns.fringes.code import MIN_SHIFTS, Fringes

__all__ = ["MIN_SHIFTS", "Fringes"]
