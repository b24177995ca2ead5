"""Fringes that are chosen while a scene is measured: a short first set, and what it asks for.

``shots`` takes sets from stored light, ``estimate`` puts all that were taken together, ``choose``
predicts what a further set would bring, and ``adapt`` goes on until enough is known.
"""
