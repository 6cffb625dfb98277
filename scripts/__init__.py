"""Commands in a checkout that is not installed.

``python -m scripts.train`` is ``vessel-gym train``, and so on.
"""
