"""All numbered figures and tables of RH01 and of R02, chapters 2 and 5, and equations that don't hold as printed."""

from __future__ import annotations

from benchmarks.papers import (
    accuracy,
    brdf,
    cat,
    comparisons,
    complexity,
    doll,
    filters,
    forms,
    frequencies,
    gallery,
    gradients,
    light,
    measuredorders,
    microfacettimes,
    phongtimes,
    printedequations,
    realharmonics,
    recentred,
    spheres,
)
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
    Entry("r02-fig2.3", "the first nine real harmonics", realharmonics.nine_harmonics),
    Entry("r02-fig2.4", "lobes about the normal and about the mirrored view", recentred.recentred_lobes),
    Entry("r02-fig5.1", "several lights and BRDFs by one map a frame", gallery.gallery),
    Entry("r02-fig5.2", "the steps of prefiltering", reason="a diagram: `invrender/prefilter`"),
    Entry("r02-fig5.3", "the idea of reflection maps", reason="a diagram: [commands.md](../commands.md)"),
    Entry("r02-fig5.4", "frequencies of light, lobe and image", frequencies.falling_frequencies),
    Entry("r02-fig5.5", "accuracy of an order, and its estimates", accuracy.accuracy_of_orders),
    Entry("r02-fig5.6", "microfacets by maps of rising order", comparisons.orders_in_pictures),
    Entry("r02-fig5.7", "orders of measured BRDFs", measuredorders.orders_of_measured),
    Entry("r02-fig5.8", "maps beside Kautz and McCool's texture", comparisons.beside_kautz_mccool),
    Entry("r02-fig5.9", "maps beside Cabral's icosahedron", comparisons.beside_cabral),
    Entry("r02-table5.1", "notation", reason="a list of symbols: [glossary.md](../glossary.md)"),
    Entry("r02-table5.2", "forms of the reflected light field", forms.forms_compared),
    Entry("r02-table5.3", "how prefiltering's cost grows", complexity.measured_exponents),
    Entry("r02-table5.4", "prefiltering for Phong's lobe", phongtimes.phong_times),
    Entry("r02-table5.5", "prefiltering for microfacets", microfacettimes.microfacet_times),
    Entry("r02-eq2.68", "light and BRDF by an explicit formula", printedequations.equation_2_68),
    Entry("r02-eq5.19", "the bound on the residual energy", accuracy.equation_5_19),
    Entry("r02-eq5.27", "Phong's lobe as a Gaussian", printedequations.equation_5_27),
    Entry("r02-eq5.31", "the width of Phong's lobe", printedequations.equation_5_31),
    Entry("rmb07-fig3", "gradients after each step of shading", gradients.steps),
    Entry("rmb07-fig4", "the sizes of the terms in common situations", gradients.situations),
    Entry("rmb07-fig5", "the terms in a scene under a near lamp", gradients.scene),
    Entry("rh01-eq19", "Phong's lobe as a Gaussian", filters.equation_19),
    Entry("rh01-eq20", "the microfacet lobe as a Gaussian", filters.equation_20),
)
ENTRIES = {entry.name: entry for entry in _ENTRIES}
