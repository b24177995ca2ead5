"""The light transport matrix as a PyTorch module: ``frames = light(panel)``, with gradients.

The product is that of :meth:`~slbench.simulate.transport.LightTransport.relight`: ``T = S B`` with
the blurred panels ``B`` (:mod:`slbench.simulate.footprints`), sums below zero set to zero, and the
ambient light added.  Its gradient is the product with the transposed matrices, which are kept
beside them, so that both ways are products of matrices in CSR form.
"""

from __future__ import annotations

import operator
import warnings
from collections.abc import Sequence
from functools import cache, reduce
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from slbench.core.errors import InputError
from slbench.core.extras import extra

if TYPE_CHECKING:
    import scipy.sparse

try:
    # PyTorch tells a module by its class, so the base is needed here.
    from torch.nn import Module
except ImportError:  # said when one is made, not when this module is read
    Module = object


class TorchLight(Module):  # type: ignore[misc]
    """A marginal of light transport as a module without parameters.

    Made by :meth:`slbench.simulate.transport.LightTransport.torch`.  ``to("cuda")`` takes it to a
    device, ``double()`` to double precision.

    Parameters
    ----------
    factors : sequence of (..., ...) csr_array
        Sparse matrices whose product is that of panel pixels to camera pixels.
    ambient : (V, U) float
        Radiance with the panel dark.
    panel : tuple of int
        Shape of one panel profile or image.
    pixels : (P,) int, optional
        Flat indices of camera pixels; all by default.
    dense : bool
        Keep the whole matrix, zeros included.
    dtype : torch.float32 or torch.float64, optional
    device : torch.device or str, optional
    """

    def __init__(
        self,
        factors: Sequence[scipy.sparse.csr_array],
        ambient: NDArray[np.floating],
        panel: tuple[int, ...],
        *,
        pixels: ArrayLike | None = None,
        dense: bool = False,
        dtype: Any = None,
        device: Any = None,
    ) -> None:
        torch = extra("torch", "torch")
        super().__init__()
        kind = torch.float32 if dtype is None else dtype
        if kind not in (torch.float32, torch.float64):
            raise InputError("light transport: dtype", "torch.float32 or torch.float64", kind)
        self.panel = panel
        self.shape: tuple[int, ...] = ambient.shape
        dark = ambient.reshape(-1)
        if pixels is not None:
            chosen = _chosen(pixels, dark.size)
            dark, self.shape = dark[chosen], (len(chosen),)
            factors = (factors[0][chosen], *factors[1:])
        if dense:
            whole = reduce(operator.matmul, factors).toarray()
            table = torch.tensor(whole, dtype=kind, device=device)
            self.register_buffer("dense", table, persistent=False)
        self.factors = 0 if dense else len(factors)
        for k in range(self.factors):
            for name, one in (("factor", factors[k]), ("transposed", factors[k].T.tocsr())):
                self.register_buffer(f"{name}{k}", _tensor(one, kind, device), persistent=False)
        dark = torch.tensor(np.ascontiguousarray(dark), dtype=kind, device=device)
        self.register_buffer("ambient", dark, persistent=False)

    def forward(self, panel: Any) -> Any:
        """Return radiance images under panel images.

        Parameters
        ----------
        panel : (K, W), (K, H) or (K, H, W) tensor
            Panel radiance per column ("u"), row ("v") or pixel ("uv"), in [0, 1].

        Returns
        -------
        (K, V, U) tensor, or (K, P) for P chosen pixels
            W / (mm^2 sr).

        Raises
        ------
        InputError
            For another shape.
        """
        if tuple(panel.shape[1:]) != self.panel:
            expected = f"shape (K, {', '.join(map(str, self.panel))})"
            raise InputError("panel", expected, tuple(panel.shape))
        seen = panel.reshape(len(panel), -1).T
        if self.factors == 0:
            seen = self.dense @ seen
        for k in reversed(range(self.factors)):
            seen = _product()(getattr(self, f"factor{k}"), getattr(self, f"transposed{k}"), seen)
        # Interpolation between nodes may undershoot where a panel is dark; light does not.
        radiance = seen.clamp(min=0.0) + self.ambient[:, None]
        return radiance.T.reshape(len(panel), *self.shape)


def _chosen(pixels: ArrayLike, count: int) -> Any:
    """Return flat indices of pixels that the camera has."""
    chosen = np.asarray(pixels)
    whole = chosen.ndim == 1 and chosen.dtype.kind in "iu" and chosen.size > 0
    if not whole or chosen.min() < 0 or chosen.max() >= count:
        expected = f"flat indices of pixels, whole numbers from 0 to {count - 1}"
        got = f"{chosen.dtype} of shape {chosen.shape}"
        raise InputError("light transport: pixels", expected, got)
    return chosen


def _tensor(matrix: scipy.sparse.csr_array, kind: Any, device: Any) -> Any:
    """Return a SciPy matrix as a CSR tensor."""
    torch = extra("torch", "torch")
    parts = (matrix.indptr, matrix.indices)
    if matrix.nnz <= np.iinfo(np.int32).max:  # which the fast libraries take
        parts = tuple(part.astype(np.int32) for part in parts)
    given = [torch.from_numpy(np.ascontiguousarray(part)).to(device) for part in parts]
    values = torch.tensor(matrix.data, dtype=kind, device=device)
    with warnings.catch_warnings():  # "beta state", of PyTorch's CSR tensors
        warnings.filterwarnings("ignore", category=UserWarning)
        return torch.sparse_csr_tensor(*given, values, size=matrix.shape)


@cache
def _product() -> Any:
    """Return the product of a CSR matrix, its transpose given too, with a dense one."""
    torch = extra("torch", "torch")

    class Product(torch.autograd.Function):  # type: ignore[misc, name-defined]
        @staticmethod
        def forward(ctx: Any, matrix: Any, transposed: Any, dense: Any) -> Any:
            ctx.matrices = matrix, transposed
            return matrix @ dense

        @staticmethod
        def backward(ctx: Any, gradient: Any) -> Any:
            matrix, transposed = ctx.matrices
            return None, None, Product.apply(transposed, matrix, gradient)

    return Product.apply
