"""Results in other programs' formats: glTF, Mitsuba, MaterialX."""
