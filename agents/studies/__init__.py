"""Ablation studies: what does the estimator cost the agent?

A study file says what is compared (`study`), a plan makes jobs of it (`plan`; `training` and
`flying` compute them), and `results` and `report` say what came out.

They may import all other folders of `agents`; commands import them.
"""
