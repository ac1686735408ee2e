"""Whether an object lies where the photographs show it, and what mistake would explain that it doesn't."""
