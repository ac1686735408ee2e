"""Every numbered figure and table of RH01 and of R02, chapters 2 and 5, drawn anew: `python -m benchmarks.papers`."""
