"""A sphere and its place, measured in masks and photographs."""
