"""The result: what it holds, how it is written and read, and the truth beside it."""
