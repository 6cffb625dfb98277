"""The gap between measured logs and their simulation, on the trials of the Esso Osaka."""
