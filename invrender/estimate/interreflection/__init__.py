"""Light that bounces between an object's parts: predicted from the fit, taken off its photographs, fitted again.

- `correction`: fit and prediction in turns, the rule by which photographs judge, and what stays taken off.
- `statement`: how much bounces, how much of it photographs ask for, and the sentences on it.
- `known_light`, `unknown_light`, `textured`: what each kind of set predicts, fits again, and takes for evidence.
"""
