"""The paper on a PUNA: Dubins paths, and an ensemble Kalman filter in the vertical plane."""
