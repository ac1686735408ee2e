"""Race with Mitsuba 3: inverse rendering of the same photographs by a differentiable path tracer, error against time.

Mitsuba is told the BRDF's formula (its own plugin of it, nothing of ours) and starts where the published simplex does.
Its settings are the best of those tried: one path per pixel (four in a minute) and one photograph per step, squared
differences, mu and sigma by their logarithms, Adam with little memory (but in long runs of unknown light), with rates
that fall exponentially to a fiftieth over each run, so that every point is a run of its own. Compiling isn't timed, nor
is judging: in known light by our exact prediction of what it found, in unknown light by its own. There it fits the
logarithm of a map of 64 x 128 pixels, held together by its total variation; in known light it is told map and source.
"""

from __future__ import annotations

import time
from collections.abc import MutableMapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from benchmarks.atlas.stage import SPHERE, Stage
from benchmarks.contest import Found, Outcome, brdf_in_known_light, judged, ours
from benchmarks.ink import BLUE, ORANGE, save, write_table
from benchmarks.kept import Kept
from benchmarks.spherephotos import SpherePhotos, sphere_photos
from capture.parallel import one_blas_thread
from invrender.model.microfacet import Microfacet
from recon.lightfield import LightField
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
_BUDGETS, _QUICK_BUDGETS = (500, 2000, 8000, 32000), (500, 1000)
_LABELS = {
    "Ks share": "absolute error",
    "mu": "absolute error",
    "sigma": "absolute error [rad]",
    "unseen photographs": "relative RMS error",
}


@dataclass(frozen=True)
class Setting:
    """Of a run of Mitsuba's. paths : per pixel and step. memory : Adam's, of squared slopes."""

    seconds: float
    paths: int
    memory: float


# Under unknown light, long runs with little memory run away.
_RUNS = {
    True: (Setting(4.0, 1, 0.9), Setting(60.0, 4, 0.9)),
    False: (Setting(15.0, 1, 0.9), Setting(120.0, 1, 0.999)),
}
_QUICK_RUN = Setting(1.0, 1, 0.9)


def draw_race(out: Path, quick: bool) -> None:
    """Write race.json, race.png and race.md; without Mitsuba, say so and draw our side alone."""
    # A sphere as large as in pictures of 320 x 240: on smaller ones what a step costs besides its rays counts too much.
    stage = Stage(views=4 if quick else 60, radius_px=30 if quick else 105)
    peer = has_mitsuba()
    if not peer:
        print(f"  {NO_LLVM}")
    settings = {"views": stage.views, "radius_px": stage.radius_px, "seed": 0, "with Mitsuba": peer}
    kept = Kept(out / "race.json", settings)
    outcomes = run_race(stage, quick, peer, kept)
    save(race_figure(outcomes), out / "race.png", kept.caption)
    write_table(out / "race.md", _table(outcomes), kept.caption)


def run_race(stage: Stage, quick: bool, peer: bool, kept: MutableMapping[str, Any]) -> list[Outcome]:
    """All runs, with known light and with unknown; those that `kept` lacks are made one after the other, and kept.

    Times are in units of our first run's of the same light, which is made again for it.
    """
    outcomes = []
    for known in (True, False):
        budgets = _QUICK_BUDGETS if quick else _BUDGETS
        runs = () if not peer else (_QUICK_RUN,) if quick else _RUNS[known]
        keys = [_key(known, f"{budget} samples") for budget in budgets]
        keys += [_key(known, f"{run.seconds:g} s") for run in runs]
        if any(key not in kept for key in keys):
            photos = _photos(stage)
            # What a first run builds for all, such as tables of lobes, isn't timed: nor is Mitsuba's compiling, nor
            # anything in a coarse version.
            if not quick:
                ours(photos, known, budgets[0])
            unit = _ours(photos, known, budgets[0])
            racer = None
            for key, setting in zip(keys, (*budgets, *runs), strict=True):
                if key in kept:
                    continue
                if isinstance(setting, int):
                    found = unit if setting == budgets[0] else _ours(photos, known, setting)
                else:
                    racer = racer or Peer(photos, known)
                    found = racer.outcome(setting)
                kept[key] = replace(found, seconds=found.seconds / unit.seconds).document()
                print(f"  {_words(found)}", flush=True)
        outcomes += [Outcome(**kept[key]) for key in keys]
    return outcomes


@lru_cache(maxsize=1)
def _photos(stage: Stage) -> SpherePhotos:
    return sphere_photos(stage, 0)


def _key(known: bool, setting: str) -> str:
    return f"{'known' if known else 'unknown'} light, {setting}"


def _ours(photos: SpherePhotos, known: bool, budget: int) -> Outcome:
    with one_blas_thread():
        return judged(photos, "lightfactor", known, f"{budget} samples", partial(ours, photos, known, budget))


def has_mitsuba() -> bool:
    """Whether Mitsuba can take part."""
    try:
        from tests.synthetic.mitsubalobes import has_llvm
    except ImportError:
        return False
    return has_llvm()


def race_figure(outcomes: Sequence[Outcome]) -> Figure:
    """Errors against time: known light above, unknown light below."""
    figure = Figure(figsize=(13, 6.5), layout="constrained")
    rows = figure.subplots(2, 4, sharex="row")
    for row, known in zip(rows, (True, False), strict=True):
        mine = [one for one in outcomes if one.known_light == known]
        for axes, (name, label) in zip(row, _LABELS.items(), strict=True):
            _draw(axes, mine, name)
            axes.set_ylabel(label, fontsize=8)
            axes.set_xlabel("time / our first run's", fontsize=8)
            axes.set_title(f"{name}, {'known' if known else 'unknown'} light", fontsize=9)
    rows[0, 0].legend(fontsize=8)
    return figure


def _draw(axes: Axes, outcomes: Sequence[Outcome], name: str) -> None:
    for method, colour, mark in (("lightfactor", BLUE, "o"), ("Mitsuba 3", ORANGE, "s")):
        mine = [one for one in outcomes if one.method == method]
        errors = [one.held_out if name == "unseen photographs" else one.errors[name] for one in mine]
        seconds = [one.seconds for one in mine]
        if mine:
            values = [np.nan if error is None else error for error in errors]
            axes.plot(seconds, values, f"-{mark}", color=colour, label=method)
    axes.set(xscale="log", yscale="log")
    axes.grid(alpha=0.2, which="both")


def _table(outcomes: Sequence[Outcome]) -> list[str]:
    return [
        "# Race with Mitsuba 3\n",
        "Times over those of our run with the fewest samples, of the same light; errors are absolute, unseen"
        " photographs relative RMS.\n",
        "| light | method | setting | time | Ks share | mu | sigma | unseen |",
        "|---|---|---|---|---|---|---|---|",
        *(
            f"| {'known' if one.known_light else 'unknown'} | {one.method} | {one.setting} | {one.seconds:.2g} |"
            + " |".join(" none" if e is None else f" {e:.2g}" for e in one.errors.values())
            + f" | {one.held_out:.3%} |"
            for one in outcomes
        ),
    ]


def _words(one: Outcome) -> str:
    light = "known" if one.known_light else "unknown"
    return f"{light} light, {one.method}, {one.setting}: unseen photographs {one.held_out:.3%}"


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
        self._run(_QUICK_RUN, None)

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
