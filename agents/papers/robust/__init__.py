"""Rudianto et al. (2024): a robust Kalman filter for uncertain systems."""
