"""Compiled loops behind the codes' decoders, one module a family.

The decoder reads every frame once and writes every result once: pixels are handled in
blocks whose intermediate sums stay in the first-level cache, one block a thread at a time,
with loops that LLVM turns into vector instructions.

Nothing here is imported before something is decoded: loading Numba takes longer than reading a
capture.
"""
