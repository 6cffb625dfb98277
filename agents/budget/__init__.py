"""The cheapest sensors with which an agent keeps a share of its score on the truth.

A suite is a grade of each sensor (`suites`). `search` decides which suites to try, and confirms the
cheapest that will do on fresh seeds; it is statistics alone. `result` computes the scores as jobs
of a study whose conditions are the suites, and `report` writes the answer.

They may import jobs, statistics, pages, studies and the environments of `agents`; a command imports
them.
"""
