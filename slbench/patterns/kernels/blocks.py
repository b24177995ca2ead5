"""How the compiled loops divide their work, and what the compiler may do to their arithmetic.

Floating-point contraction and reassociation are allowed; NaN and infinity keep their
meaning, since they mark pixels that cannot be decoded.
"""

BLOCK = 512  # pixels; the block's float64 sums fit the first-level cache with room to spare
PAD = 16  # keeps the rows of the scratch array off each other's cache sets
FAST = {"contract", "reassoc", "nsz", "arcp"}
