"""The commands of this package, one module each; only typer is imported up there, so that --help is instant."""
