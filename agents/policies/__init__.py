"""Learned policies: their checkpoints, and those that come with the package."""
