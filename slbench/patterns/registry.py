"""The families of codes, by the ``kind`` that tables name."""

from slbench.core.registry import Registry
from slbench.patterns.base import Code

#: Asked in this order for the words of the short text; packages add theirs by entry points.
pattern_codes: Registry[type[Code]] = Registry(
    "pattern code",
    "slbench.codes",
    {
        "flat": "slbench.patterns.flat:Flat",
        "gray": "slbench.patterns.gray:GrayCode",
        "fringes": "slbench.patterns.fringes:Fringes",
        "micro": "slbench.patterns.codes.micro:MicroPhaseShifting",
        "xor": "slbench.patterns.codes.xor:XorCode",
        "orders": "slbench.patterns.codes.orders:PhaseCodedOrders",
        "hamiltonian": "slbench.patterns.codes.hamiltonian:HamiltonianCode",
        "two-plus-one": "slbench.patterns.codes.two_plus_one:TwoPlusOne",
        "two-step": "slbench.patterns.codes.two_step:TwoStep",
        "trapezoid": "slbench.patterns.codes.trapezoidal:Trapezoidal",
        "binary-fringes": "slbench.patterns.codes.binary:BinaryFringes",
        "embedded": "slbench.patterns.codes.embedded:EmbeddedPhaseShifting",
        "modulated": "slbench.patterns.codes.modulated:ModulatedPhaseShifting",
        "images": "slbench.patterns.images:Images",
        "composite": "slbench.patterns.codes.spatial.composite:CompositeFringes",
        "fourier": "slbench.patterns.codes.spatial.fourier:FourierTransform",
        "speckle": "slbench.patterns.codes.random.speckle:Speckle",
        "optimised": "slbench.patterns.codes.random.optimised:OptimisedCode",
        "de-bruijn": "slbench.patterns.codes.spatial.de_bruijn:DeBruijn",
        "m-array": "slbench.patterns.codes.spatial.m_array:MArray",
    },
    base="slbench.patterns.base:Code",
)
