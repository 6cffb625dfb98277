"""Tuning of estimator and controller together, in closed loop, on common random numbers.

`arm` says what is tuned, `trials` scores candidates on equal seeds, `search` finds the best, and
`tuned` is the file that is written. It may import rollouts, controllers and metrics; commands and
studies import it.
"""
