"""Which parameters of a device are fitted: its camera model, and what is fixed of it.

Those of central devices are nested.  ``plain`` is a pinhole; ``radial`` has k1 and k2; ``brown``
adds p1, p2 and k3 (D. C. Brown, 1971); ``rational`` adds k4, k5 and k6 for wide angles (D. Claus
and A. Fitzgibbon, 2005), which are told together only
(:mod:`~slbench.calibration.bundle.adjustment.field`).
A sensor's tilt is not fitted: to first order it is the tangential distortion of ``brown``, and a
shift of the centre; boards hardly tell them apart.  Nor is a thin prism.  Both may be stated.

``telecentric`` is a camera with parallel rays (B. Li and S. Zhang, "Flexible calibration method for
microscopic structured light system using telecentric lens", Opt. Express 23(20), 2015): a
magnification along each axis, k1, p1 and p2.  Its centre is the panel's, as a shift of it is one of
all else, but for what it makes of k1: that of p1 and p2.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from slbench.core.errors import InputError
from slbench.core.registry import quoted
from slbench.rig.coefficients import COEFFICIENTS
from slbench.rig.parameters import LENS, OPTICS, POSE, ROLES

FOCAL = ("fx_px", "fy_px")
_RADIAL = ("k1", "k2")
_BROWN = (*_RADIAL, "p1", "p2", "k3")
#: Parameters of a device's model, beside focal lengths and centre.
DEVICE_MODELS: dict[str, tuple[str, ...]] = {
    "plain": (),
    "radial": _RADIAL,
    "brown": _BROWN,
    "rational": (*_BROWN, "k4", "k5", "k6"),
}
TELECENTRIC = "telecentric"
#: Those of cameras.
CAMERA_MODELS = DEVICE_MODELS | {TELECENTRIC: ("k1", "p1", "p2")}
#: What no picture of a telecentric camera tells: where its axis is, and how far along it.
CONVENTIONS = ("camera.cx_px", "camera.cy_px", "projector.tz_mm")


def free_parameters(
    camera_model: str, projector_model: str, fixed: Sequence[str] = ()
) -> tuple[str, ...]:
    """Return the parameters of a rig that are fitted, the camera's frame being the world's.

    Parameters
    ----------
    camera_model, projector_model : str
        Of :data:`CAMERA_MODELS` and :data:`DEVICE_MODELS`.
    fixed : sequence of str
        Full names (``camera.k3``) that are not.

    Raises
    ------
    InputError
        For another model.
    """
    names = []
    chosen = ((camera_model, CAMERA_MODELS), (projector_model, DEVICE_MODELS))
    for role, (model, models) in zip(ROLES, chosen, strict=True):
        if model not in models:
            raise InputError(
                f"{role} model", f"one of {', '.join(models)}", quoted(model, tuple(models))
            )
        own = (*LENS, *models[model], *(POSE if role == "projector" else ()))
        names += [f"{role}.{name}" for name in own]
    told = CONVENTIONS if camera_model == TELECENTRIC else ()
    return tuple(name for name in names if name not in (*fixed, *told))


def read_fixed(texts: Sequence[str], where: str) -> dict[str, float | None]:
    """Parse what is fixed: ``k3``, ``camera.k3`` or ``camera.fx_px=5000``.

    Parameters
    ----------
    texts : sequence of str
        A name without a device is of both.
    where : str
        The option's name, for messages.

    Returns
    -------
    dict of str to float or None
        Values by full names; None is where the parameter starts: the panel's middle for
        ``cx_px`` and ``cy_px``, zero for distortion.

    Raises
    ------
    InputError
        For a name that is not known, a value that is no number, or none where there is no start.
    """
    fixed: dict[str, float | None] = {}
    known = tuple(f"{role}.{name}" for role in ROLES for name in OPTICS)
    for text in texts:
        name, _, number = text.partition("=")
        name = name.strip()
        full = [f"{role}.{name}" for role in ROLES] if name in OPTICS else [name]
        if full[0] not in known:
            expected = "a parameter of a device, such as k3 or camera.cx_px"
            raise InputError(where, expected, quoted(name, (*OPTICS, *known)))
        try:
            value = float(number) if number else None
        except ValueError:
            raise InputError(f"{where} {name}", "a number", repr(number)) from None
        if value is None and full[0].partition(".")[2] in FOCAL:
            raise InputError(f"{where} {name}", "a value: NAME=VALUE", "none")
        fixed |= dict.fromkeys(full, value)
    return fixed


def start_values(
    fixed: Mapping[str, float | None],
    sizes: Mapping[str, tuple[int, int]],
    camera_model: str = "brown",
) -> dict[str, float]:
    """Return the values of what is fixed by full names, with those that were left open.

    Raises
    ------
    InputError
        For a value of a telecentric camera that is in units of its distance, which is found only.
    """
    if camera_model == TELECENTRIC:
        fixed = dict.fromkeys(CONVENTIONS[:2]) | dict(fixed)
        for own in (*FOCAL, *COEFFICIENTS):
            name = f"camera.{own}"
            if fixed.get(name) or (own in FOCAL and name in fixed):
                expected = "no value for a telecentric camera, whose distance is a convention"
                raise InputError(f"fixed {name}", expected, fixed[name])
    middle = {
        f"{role}.{name}": 0.5 * (sizes[role][axis] - 1)
        for role in ROLES
        for axis, name in enumerate(("cx_px", "cy_px"))
    }
    return {
        name: middle.get(name, 0.0) if value is None else value for name, value in fixed.items()
    }
