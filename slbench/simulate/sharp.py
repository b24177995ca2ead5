"""What a perfect focus stack would show: the frames of a scene through lenses without defocus.

The frames are exposed as those of a stack were, whose radiance is the same wherever its picture is
sharp.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from slbench.capture.capture import Capture
from slbench.capture.stack import FocusStack
from slbench.detector import DetectorModel
from slbench.rig import Rig
from slbench.scene.model import Exposure
from slbench.simulate.expose import Shutter, capture, radiance_batches, shutter_for
from slbench.simulate.transport import LightTransport

Array = NDArray[np.float64]


def expected_frames(
    stack: FocusStack, transport: LightTransport, detector: DetectorModel, exposure: Exposure
) -> Iterator[tuple[int, Array]]:
    """Yield index and picture of every frame of a stack as it is without blur and noise, DN.

    Parameters
    ----------
    stack : FocusStack
        In memory, with the rig of each setting.
    transport : LightTransport
        Through lenses without defocus (:meth:`slbench.rig.Rig.all_in_focus`).
    detector : DetectorModel
    exposure : Exposure
    """
    shutter = stack_shutter(stack, transport, detector, exposure)
    middle = _middle(stack)
    projector = _rig(middle).projector
    for indices, radiance in radiance_batches(transport, middle.sequence, projector):
        for k, image in zip(indices.tolist(), radiance, strict=True):
            light = np.maximum(image, 0.0) * shutter.photons
            yield k, detector.expected_dn(light, shutter.time_s)


def all_in_focus(
    stack: FocusStack, transport: LightTransport, detector: DetectorModel, exposure: Exposure
) -> Capture:
    """Return the expected frames of a stack without defocus, rounded as a camera does.

    Parameters are those of :func:`expected_frames`.
    """
    middle = _middle(stack)
    shutter = stack_shutter(stack, transport, detector, exposure)
    rig = _rig(middle).all_in_focus()
    faultless = exposure.without_frame_errors().single()  # the stack's own time holds a factor
    return capture(
        transport, middle.sequence, rig, detector, faultless, noise=False, shutter=shutter
    )


def stack_shutter(
    stack: FocusStack, transport: LightTransport, detector: DetectorModel, exposure: Exposure
) -> Shutter:
    """Return the shutter that a stack was captured with, for the light without defocus.

    The time is the stack's own.  Parameters are those of :func:`expected_frames`.
    """
    middle = _middle(stack)
    found = shutter_for(transport, _rig(middle).camera, detector, exposure)
    time = middle.exposure_s
    return found if time is None else Shutter(found.photons * time / found.time_s, time)


def _middle(stack: FocusStack) -> Capture:
    return stack.captures[len(stack) // 2]


def _rig(capture: Capture) -> Rig:
    assert capture.rig is not None  # a simulated one has it
    return capture.rig
