"""Work in tasks, a photograph each, whose results lie on disk: done by threads, local processes or a Dask cluster."""
