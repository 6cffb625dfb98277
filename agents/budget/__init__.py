"""The cheapest sensors with which an agent reaches a share of its score with perfect knowledge.

A suite is a grade of each sensor (`suites`), and `sensors` orders grades by their errors. `search`
decides which suites to try, and confirms the cheapest that suffices on fresh seeds; it is
statistics alone. `result` computes the scores as jobs of a study whose conditions are the suites,
and `report` writes the answer.

They may import jobs, statistics, pages, studies and the environments of `agents`; a command imports
them.
"""
