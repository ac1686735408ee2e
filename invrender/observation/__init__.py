"""A photo set as the estimates take it: the object in its place, and samples of its photographs."""
