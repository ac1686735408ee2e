"""The main job: a photo set in, a factorization out; one module for each kind of set."""
