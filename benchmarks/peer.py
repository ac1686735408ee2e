"""Mitsuba 3 as a peer in the race: a sphere's BRDF, and a map of its light, by gradients through a path tracer.

Mitsuba is told the BRDF's formula (its own plugin of it, nothing of ours) and starts where the published simplex does.
Squared differences, mu and sigma by their logarithms, Adam with rates that fall exponentially to a fiftieth over each
run, so that every run is one of its own. Compiling isn't timed, nor is judging: in known light by our exact prediction
of what it found, in unknown light by its own. There it fits the logarithm of a map of 64 x 128 pixels, held together by
its total variation; in known light it is told map and source.
"""

from __future__ import annotations

import time
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.atlas.stage import SPHERE
from benchmarks.contest import Found, Outcome, brdf_in_known_light, judged
from benchmarks.spherephotos import SpherePhotos
from invrender.brdf.microfacet import Microfacet
from recon.sampling.lightfield import LightField
from synthetic.lights.illumination import Illumination

Floats = NDArray[np.float64]

NO_LLVM = (
    "Mitsuba 3 takes no part: it needs the extra `reference` and LLVM 16 or newer (libllvm19, or"
    " DRJIT_LIBLLVM_PATH)"
)
_START = {"kd": 0.15, "ks": 0.1, "mu": 1.5, "sigma": 0.15}
_RANGES = {"kd": (0.0, 1.0), "ks": (0.0, 1.0), "mu": (1.02, 3.0), "sigma": (0.02, 0.7)}
_ALBEDO = _START["kd"] + _START["ks"]
# Of these numbers the logarithm of what they are above this is fitted.
_LEAST = {"mu": 1.0, "sigma": 0.0}
# Rates of Adam: of the BRDF in known light and in unknown, and of the logarithm of the map.
_RATE_KNOWN, _RATE_UNKNOWN, _RATE_MAP = 0.03, 0.01, 0.2
_DECAY = 0.02
_MAP_ROWS, _VARIATION = 64, 1e-3
# How far the logarithm of a pixel may go from the start: lamps need 8, and where no path goes it runs away.
_SPAN = 9.0
_WARM_UP = 3
# Paths per pixel by which recovered light is judged: what they leave of noise is a percent or so.
_JUDGED = 1024


@dataclass(frozen=True)
class Setting:
    """Of a run of Mitsuba's. paths : per pixel and step. memory : Adam's, of squared slopes."""

    seconds: float
    paths: int
    memory: float


def has_mitsuba() -> bool:
    """Whether Mitsuba can take part."""
    try:
        from tests.synthetic.mitsubalobes import has_llvm
    except ImportError:
        return False
    return has_llvm()


class Peer:
    """Mitsuba with a set of photographs loaded and its kernels compiled."""

    def __init__(self, photos: SpherePhotos, known: bool) -> None:
        import mitsuba as mi

        mi.set_variant("llvm_ad_rgb")
        _register()
        self.photos, self.known = photos, known
        self.scene = mi.load_dict(_scene(photos, known))
        self.sensors = self.scene.sensors()
        self.targets = [mi.TensorXf(image.radiance) for image in photos.images]
        self.masks = [mi.TensorXf((image.radiance != 0).astype(np.float32)) for image in photos.images]
        self.level = float(np.mean([(image.radiance**2).mean() for image in photos.images]))
        self._run(Setting(0.0, 1, 0.9), None)

    def outcome(self, setting: Setting) -> Outcome:
        """A run of its own."""
        return judged(
            self.photos,
            "Mitsuba 3",
            self.known,
            f"{setting.seconds:g} s, {setting.paths} paths, memory {setting.memory:g}",
            partial(self._fit, setting),
        )

    def _fit(self, setting: Setting) -> Found:
        import mitsuba as mi

        self._run(setting, setting.seconds)
        parameters = mi.traverse(self.scene)
        found = {name: np.array(parameters[f"object.bsdf.{name}"]).ravel() for name in _START}
        mu, sigma = float(found["mu"][0]), float(found["sigma"][0])
        if self.known:
            return brdf_in_known_light(
                Microfacet(found["kd"].astype(float), found["ks"].astype(float), mu, sigma),
                self.photos.stage.lighting,
            )
        share = float(found["ks"][1] / (found["kd"][1] + found["ks"][1]))
        return Found(share, mu, sigma, self._unseen)

    def _unseen(self, field: LightField) -> Floats:
        import mitsuba as mi

        place = next(k for k, other in enumerate(self.photos.held_out) if other is field)
        sensor = self.sensors[len(self.photos.cameras) + place]
        image = np.array(mi.render(self.scene, sensor=sensor, spp=_JUDGED, seed=9), float)
        return np.asarray(image[field.rows, field.columns])

    def _run(self, setting: Setting, limit: float | None) -> None:
        """Optimise from the start for a time, or for a few steps."""
        import drjit as dr
        import mitsuba as mi

        scene, rng, level = self.scene, np.random.default_rng(0), 0.0
        rate = _RATE_KNOWN if self.known else _RATE_UNKNOWN
        parameters = mi.traverse(scene)
        adam = mi.ad.Adam(lr=rate, beta_1=0.9, beta_2=setting.memory)
        keys = {name: f"object.bsdf.{name}" for name in _START}
        for name, first in _START.items():
            adam[name] = mi.Float(np.log(first - _LEAST[name])) if name in _LEAST else mi.Color3f(first)
        if not self.known:
            brightest = max(float(image.radiance.mean()) for image in self.photos.images)
            level = float(np.log(brightest))
            flat = np.full((_MAP_ROWS, 2 * _MAP_ROWS, 3), level, np.float32)
            adam["map"] = mi.TensorXf(flat)
            adam.set_learning_rate({"map": _RATE_MAP})
        step, taken = 0, 0.0
        begin = time.perf_counter()
        while step < _WARM_UP if limit is None else taken < limit:
            k = int(rng.integers(len(self.targets)))
            for name, key in keys.items():
                by_log = name in _LEAST
                parameters[key] = _LEAST[name] + dr.exp(adam[name]) if by_log else adam[name]
            if not self.known:
                # Light and BRDF know their product only: their scale is the start's, or both run away.
                parameters[keys["kd"]], parameters[keys["ks"]] = _ALBEDO - adam["ks"], adam["ks"]
                parameters["sky.data"] = _padded(dr.exp(adam["map"]))
            parameters.update()
            image = mi.render(
                scene,
                parameters,
                sensor=self.sensors[k],
                spp=setting.paths,
                seed=int(rng.integers(1 << 30)),
            )
            loss = dr.mean(dr.square((image - self.targets[k]) * self.masks[k]), axis=None) / self.level
            if not self.known:
                loss += _VARIATION * _variation(adam["map"])
            dr.backward(loss)
            for _, value in adam.items():
                slope = dr.grad(value)
                # A path that divides by 0 spoils all that it touches, and what Adam remembers for good.
                dr.set_grad(value, dr.select(dr.isfinite(slope), slope, 0))
            adam.step()
            for name, ends in _RANGES.items():
                low, high = np.log(np.array(ends) - _LEAST[name]) if name in _LEAST else ends
                high = _ALBEDO if name == "ks" and not self.known else high
                adam[name] = dr.clip(adam[name], float(low), float(high))
            if not self.known:
                adam["map"] = dr.clip(adam["map"], float(level - _SPAN), float(level + _SPAN))
            dr.sync_thread()
            step, taken = step + 1, time.perf_counter() - begin
            fall = _DECAY ** min(taken / (limit or 1.0), 1.0)
            adam.set_learning_rate(
                dict.fromkeys(_START, rate * fall) | ({} if self.known else {"map": _RATE_MAP * fall})
            )


def _padded(texels: Any) -> Any:
    """Texels (h, w, 3) with the column that the plugin keeps on either side."""
    import mitsuba as mi

    rows, columns = texels.shape[0], texels.shape[1]
    around = (np.arange(-1, columns + 1) % columns)[None, :, None] * 3 + np.arange(3)
    index = np.arange(rows)[:, None, None] * columns * 3 + around
    import drjit as dr

    flat = dr.gather(mi.Float, texels.array, mi.UInt32(index.ravel().astype(np.uint32)))
    return mi.TensorXf(flat, shape=(rows, columns + 2, 3))


def _variation(values: Any) -> Any:
    """Mean absolute difference of neighbours."""
    import drjit as dr

    return dr.mean(dr.abs(values[1:] - values[:-1]), axis=None) + dr.mean(
        dr.abs(values[:, 1:] - values[:, :-1]), axis=None
    )


def _scene(photos: SpherePhotos, known: bool) -> dict[str, Any]:
    import mitsuba as mi

    from tests.synthetic.mitsubascene import _MILLIMETRES, _sensor, emitters

    stage = photos.stage
    described: dict[str, Any] = {
        "type": "scene",
        "integrator": {"type": "direct", "emitter_samples": 1, "bsdf_samples": 1, "hide_emitters": True},
        "object": {
            "type": "sphere",
            "center": (_MILLIMETRES * SPHERE.centre).tolist(),
            "radius": _MILLIMETRES * SPHERE.radius,
            "bsdf": {"type": "rh01_fitted"},
        },
    }
    if known:
        described |= emitters(Illumination("light", stage.areas, stage.sources))
    else:
        grey = np.ones((_MAP_ROWS, 2 * _MAP_ROWS, 3), np.float32)
        described["sky"] = {"type": "envmap", "bitmap": mi.Bitmap(grey)}
    for k, camera in enumerate((*photos.cameras, *photos.unseen_cameras)):
        # Of the orthogonal sampler's counts, one sample per pixel is none.
        described[f"sensor{k:03d}"] = _sensor(camera, 1) | {
            "sampler": {"type": "independent", "sample_count": 1}
        }
    return described


def _register() -> None:
    """RH01's BRDF as a plugin whose parameters can be fitted."""
    import drjit as dr
    import mitsuba as mi

    class Fitted(mi.BSDF):
        """Kd + Ks F(mu, theta_o) S / (4 cos theta_i cos theta_o) [RH01, section 5.2]; `eval` has the cosine."""

        def __init__(self, props: Any) -> None:
            mi.BSDF.__init__(self, props)
            self.kd, self.ks = mi.Color3f(_START["kd"]), mi.Color3f(_START["ks"])
            self.mu, self.sigma = mi.Float(_START["mu"]), mi.Float(_START["sigma"])
            flags = mi.BSDFFlags.DiffuseReflection | mi.BSDFFlags.GlossyReflection | mi.BSDFFlags.FrontSide
            self.m_components, self.m_flags = [flags], flags

        def traverse(self, cb: Any) -> None:
            for name in _START:
                cb.put(name, getattr(self, name), mi.ParamFlags.Differentiable)

        def eval(self, ctx: Any, si: Any, wo: Any, active: Any = True) -> Any:
            light, viewer = wo, si.wi
            above = (light.z > 0) & (viewer.z > 0)
            half = dr.normalize(light + viewer)
            fresnel = mi.fresnel(viewer.z, self.mu)[0] / ((self.mu - 1) / (self.mu + 1)) ** 2
            angle = dr.safe_acos(half.z)
            facets = dr.exp(-dr.square(angle / self.sigma)) / (np.pi * dr.square(self.sigma))
            lobe = fresnel * facets / (4 * dr.maximum(viewer.z, 1e-4))
            return dr.select(active & above, self.kd * light.z + self.ks * lobe, 0)

        def pdf(self, ctx: Any, si: Any, wo: Any, active: Any = True) -> Any:
            half = dr.normalize(wo + si.wi)
            seen = self._facets().pdf(si.wi, half) / (4 * dr.dot(wo, half))
            above = (wo.z > 0) & (si.wi.z > 0)
            return dr.select(active & above, (seen + mi.warp.square_to_cosine_hemisphere_pdf(wo)) / 2, 0)

        def sample(self, ctx: Any, si: Any, sample1: Any, sample2: Any, active: Any = True) -> Any:
            half, _ = self._facets().sample(si.wi, sample2)
            by_cosine = mi.warp.square_to_cosine_hemisphere(sample2)
            wo = dr.detach(dr.select(sample1 < 0.5, by_cosine, mi.reflect(si.wi, half)))
            bs = dr.zeros(mi.BSDFSample3f)
            bs.wo, bs.eta = wo, 1.0
            bs.sampled_type, bs.sampled_component = mi.UInt32(+self.m_flags), mi.UInt32(0)
            bs.pdf = dr.detach(self.pdf(ctx, si, wo, active))
            active &= bs.pdf > 0
            return bs, dr.select(active, self.eval(ctx, si, wo, active) / bs.pdf, 0)

        def eval_pdf(self, ctx: Any, si: Any, wo: Any, active: Any = True) -> Any:
            return self.eval(ctx, si, wo, active), self.pdf(ctx, si, wo, active)

        def _facets(self) -> Any:
            """What directions are drawn by: as wide as the lobe is now."""
            return mi.MicrofacetDistribution(mi.MicrofacetType.GGX, dr.detach(self.sigma), True)

    mi.register_bsdf("rh01_fitted", Fitted)
