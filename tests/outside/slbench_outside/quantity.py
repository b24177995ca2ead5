from slbench.bench.claims.quantities import Quantity

LIT_SHARE = Quantity(lambda scan: scan.truth.lit.mean())
