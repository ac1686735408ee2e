"""Scenes as TOML files: their schema, what is built from them, and those that come along."""
