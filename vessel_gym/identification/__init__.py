"""System identification: a vessel's manoeuvring model, with its uncertainty, from the logs of its trials.

It imports `estimators`, `vessel_gym.logs` and `vessel_gym.vehicles.manoeuvring`; commands and environments import it.
"""
