"""A tour of lightfactor in cells: from a photo set to numbers with error bars, new pictures and exported files.

    python docs/tour.py [SET]

SET is the folder of a photo set of yours; without it a small synthetic sphere is photographed first. Editors that know
`# %%` run it cell by cell. What the tour writes goes into a new folder, whose name it prints.
"""

# %% What the tour needs
# Everything that scripts and notebooks use is in this one module; docs/python.md lists it.

import sys
import tempfile
from pathlib import Path

import lightfactor as lf

out = Path(tempfile.mkdtemp(prefix="lightfactor-tour-"))
print(f"Files of this tour: {out}")

# %% Before the photographs
# A plan computes what a scene's photographs will determine. It tries a hundred further views and lamps, too, and says
# which single one would help most. Then the scene is photographed, with noise, as a camera would.

if len(sys.argv) > 1:
    folder = Path(sys.argv[1])
else:
    print(lf.plan("tour", samples=1000))
    folder = lf.synth("tour", out / "set")

# %% The photo set
# A photo set is a folder with a photoset.toml, which names photographs, cameras and lightings. Loading it checks all of
# this, and says in a sentence what is wrong.

photoset = lf.load_photoset(folder)
for photo in photoset.photos:
    print(f"{photo.label}: {photo.camera.width} x {photo.camera.height}, held out: {photo.held_out}")

# %% The fit
# Processing recovers the BRDF, and the light where it is unknown. It chooses the simplest model that predicts unseen
# photographs well. A real set takes minutes; `progress=True` shows bars. 60000 samples are usual; these are fewer.

fit = lf.process(photoset, samples=3000)
print(fit)

# %% The numbers
# Each has a value, a standard deviation and a status. One that the photographs don't determine has no value,
# but a reason and a remedy.

for number in (fit.brdf.kd, fit.brdf.ks, fit.brdf.mu, fit.brdf.sigma):
    print(number.name, number.value, number.std, number.status, number.reason)

# %% The evidence
# Errors are relative RMS over the object's pixels. `unseen` counts: a fit that has not seen the photograph made it.

print(f"fitted {fit.error.fitted:.2%}, unseen {fit.error.unseen:.2%}")
for model in sorted(fit.models, key=lambda model: model.unseen)[:4]:
    print(f"{model.name}: {model.unseen:.2%}{' (chosen)' if model.chosen else ''}")

# %% The light
# Sources have directions and irradiances; everything else is a lat-long map, or None where it is dark.

for light in fit.lightings:
    print(
        light.name,
        light.directions.round(3),
        light.irradiances,
        None if light.map is None else light.map.shape,
    )

# %% Figures
# These are matplotlib figures, as the report has them.

fit.plot_lighting().savefig(out / "lighting.png")
fit.plot_errors().savefig(out / "errors.png")
fit.plot_brdf().savefig(out / "brdf.png")

# %% Other views and other light
# A picture has linear radiance, the share of each pixel that the object covers, and on request standard deviations.

side = fit.render(view=(60, 20), size=(160, 120), lighting=fit.lightings[0].name, std=True)
lamp = fit.render(view=(60, 20), size=(160, 120), sources=[(90, 45, 2.0)])
lf.save_picture(side, out / "side.exr")
lf.save_picture(lamp, out / "lamp.png")
print(f"standard deviation up to {side.std.max():.2g}, radiance up to {side.radiance.max():.3g}")

# %% Against the truth
# A synthetic set knows its truth. Two fits are compared in the same way.

if (folder / "truth.json").exists():
    print(lf.compare(fit, folder / "truth.json").verdict)

# %% Files
# A saved fit is the folder that `lightfactor process` writes: result.json, report.html, predicted photographs. Exports
# say how far another program's material is from the BRDF that was found.

saved = lf.read_fit(fit.save(out / "result"), photoset=folder)
exported = lf.export(saved, out / "web", "gltf")
print(
    f"{exported.files[0].name} differs from the BRDF by {exported.mapping.relative_rms:.1%} under single sources"
)
