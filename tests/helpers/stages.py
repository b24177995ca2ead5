"""The stages of a scan given a scene: each takes of it what it needs."""

from dataclasses import replace

from slbench.simulate import expose, floors, stack
from slbench.simulate.render import groundtruth
from slbench.simulate.render import trace as tracing


def trace(scene, marginals=None, *, samples=None, **options):
    """Trace a scene as it stands, for what its patterns vary along."""
    kept = scene.sequence.variations if marginals is None else marginals
    parts = scene.objects, scene.rig, scene.light
    return tracing.trace(*parts, kept, samples=samples or scene.samples, **options)


def ground_truth(scene):
    """Compute the ground truth of a scene."""
    return groundtruth.ground_truth(scene.objects, scene.rig)


def capture(scene, transport, **options):
    """Expose the frames of a scene's patterns."""
    parts = scene.sequence, scene.rig, scene.detector, scene.exposure
    return expose.capture(transport, *parts, **options)


def shutter_for(scene, transport):
    """Return the shutter of a scene."""
    return expose.shutter_for(transport, scene.rig.camera, scene.detector, scene.exposure)


def noise_free_coordinates(scene, transport):
    """Decode the radiance of a scene's patterns."""
    return floors.noise_free_coordinates(transport, scene.sequence, scene.rig.projector)


def floor_rms_px(scene, transport, truth):
    """Return the renderer's floor of a scene."""
    return floors.floor_of(transport, scene.sequence, scene.rig.projector, truth).rms_px


def with_lit_frame(scene):
    """Return a scene whose patterns have a fully lit frame."""
    return replace(scene, sequence=stack.with_lit_frame(scene.sequence))
