"""The cheapest sensors with which an agent keeps a share of its score on the truth.

A suite is a grade of each sensor. `search` decides what is flown, and `confirm` tests what it found
on fresh seeds; both are statistics alone and fly nothing. `flights` makes jobs of what they ask
for, and `report` writes the answer.

They may import jobs, statistics, pages and the environments of `agents`; a command imports them.
"""
