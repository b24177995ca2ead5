"""Matching: the decoder of any code, by what its places show (:class:`MatchedCode`)."""

from slbench.patterns.matching.code import MatchedCode

__all__ = ["MatchedCode"]
