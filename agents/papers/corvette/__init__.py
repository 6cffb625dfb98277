"""A. E. Hermawan's thesis (2020): KF-UMV-UI on a SIGMA corvette."""
