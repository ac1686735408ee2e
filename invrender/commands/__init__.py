"""Commands of this package: parse, call, print."""
