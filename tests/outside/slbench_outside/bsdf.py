from slbench.core.validation.types import Share
from slbench.scene.surfaces.bsdfs import Bsdf, grey


class SmoothPlastic(Bsdf):
    """A diffuse base under a smooth coat."""

    albedo: Share = 0.5

    def mitsuba(self):
        return {"type": "plastic", "diffuse_reflectance": grey(self.albedo)}
