"""Many photo sets: each solved by a process of its own, all on one page."""
