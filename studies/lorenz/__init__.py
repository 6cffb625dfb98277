"""Published scores of ensemble and particle filters on Lorenz-63 and Lorenz-96: ``python -m studies.tables lorenz``."""
