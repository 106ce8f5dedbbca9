"""Monte Carlo studies: the same runs for every estimator, and what they show together.

The way of a run: `runs` makes it and gives its `record`; `execute` spreads runs over
workers; `folder` keeps records; `collect` adds them up; `summary` and `verdict` say what
they mean.
"""
