from __future__ import annotations

from capture.figures import printable


def test_names_are_drawn_without_a_warning():
    # Warnings are errors here: matplotlib warns of every glyph that its font lacks.
    from matplotlib.figure import Figure

    figure = Figure()
    figure.suptitle(printable("\N{CJK UNIFIED IDEOGRAPH-7403}_$a_0$.jpg"))
    figure.savefig("/dev/null", format="png")
    assert printable("größe_1.png") == "größe_1.png"
    assert printable("\N{CJK UNIFIED IDEOGRAPH-7403}") == "\N{WHITE SQUARE}"
