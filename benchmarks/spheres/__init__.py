"""RH01's Fig. 7, 11 and 12 on synthetic spheres: truth beside estimate, coverage, time against error."""
