"""Commands of a checkout alone: `scripts.reproduce`, for the papers are not in the package.

Commands of the package run there without an installation, too: ``python -m vessel_gym train``.
"""
