"""Planning: what photographs that nobody has taken yet will determine, and which one more would help most."""
