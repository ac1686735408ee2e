"""All numbered figures and tables of RH01 and of R02, chapters 2 and 5, and equations that don't hold as printed."""

from __future__ import annotations

from benchmarks.papers import brdf, cat, doll, filters, gradients, light, spheres
from benchmarks.papers.entry import Entry

PAPERS = {
    "rh01-fig": "RH01, figures",
    "r02-fig2": "R02, chapter 2, figures",
    "r02-fig5": "R02, chapter 5, figures",
    "r02-table": "R02, chapter 5, tables",
    "rmb07-fig": "RMB07, figures of section 4",
    "rh01-eq": "RH01, equations that don't hold as printed",
    "r02-eq": "R02, equations that don't hold as printed",
}

_ENTRIES = (
    Entry("rh01-fig1", "a cat, photographed and rendered", cat.new_light, coarse=False),
    Entry("rh01-fig2", "notation", reason="a list of symbols: [glossary.md](../glossary.md)"),
    Entry(
        "rh01-fig3", "a surface's frame, rotated", reason="a diagram: [theory.md](../theory.md), section 1"
    ),
    Entry("rh01-fig4", "the clamped cosine and its coefficients", filters.clamped_cosine),
    Entry("rh01-fig5", "Phong's coefficients", filters.phong_lobe),
    Entry("rh01-fig6", "a BRDF in spherical harmonics, and its ringing", brdf.slices),
    Entry("rh01-fig7", "a BRDF under complex light beside a measured one", brdf.parameters),
    Entry("rh01-fig8", "the dual representation of light", light.dual_steps),
    Entry("rh01-fig9", "ways of recovering light", light.methods),
    Entry("rh01-fig10", "sigma from a source in recovered light", spheres.source_width),
    Entry("rh01-fig11", "BRDFs of six spheres, in known and unknown light", spheres.parameters),
    Entry("rh01-fig12", "six spheres rendered, and the light that they tell", spheres.renderings),
    Entry("rh01-fig13", "a cat in known and unknown light, rendered", cat.pictures, coarse=False),
    Entry("rh01-fig14", "a cat's BRDF and its light", cat.parameters, coarse=False),
    Entry("rh01-fig15", "a textured BRDF under complex light", doll.texture, coarse=False),
    Entry("r02-fig2.1", "reflection in flatland", reason="a diagram: [theory.md](../theory.md), section 2"),
    Entry(
        "r02-fig2.2",
        "the rotations of a surface's frame",
        reason="a diagram: [conventions.md](../conventions.md)",
    ),
    Entry("r02-fig5.2", "the steps of prefiltering", reason="a diagram: `invrender/prefilter`"),
    Entry("r02-fig5.3", "the idea of reflection maps", reason="a diagram: [commands.md](../commands.md)"),
    Entry("r02-table5.1", "notation", reason="a list of symbols: [glossary.md](../glossary.md)"),
    Entry("rmb07-fig3", "gradients after each step of shading", gradients.steps),
    Entry("rmb07-fig4", "the sizes of the terms in common situations", gradients.situations),
    Entry("rmb07-fig5", "the terms in a scene under a near lamp", gradients.scene),
    Entry("rh01-eq19", "Phong's lobe as a Gaussian", filters.equation_19),
    Entry("rh01-eq20", "the microfacet lobe as a Gaussian", filters.equation_20),
)
ENTRIES = {entry.name: entry for entry in _ENTRIES}
