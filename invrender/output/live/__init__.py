"""Live pictures: a result under light that a browser turns, by reflection maps on the graphics card."""
