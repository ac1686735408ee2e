"""Commands on the whole program; `lightfactor.cli` puts them together."""
