"""Monte Carlo studies: the same runs for every estimator, and what they show together.

`runs` makes one run and reduces it to a `record` of fixed size; `execute` spreads the runs
over workers; `folder` keeps the records; `collect` adds them up; `summary` computes accuracy
and consistency from the sums, and `verdict` puts them into words.

A *run* is one draw of truth, noise and prior, by its number. A *row* is one track: an
estimator has one, or two where a second one, ``NAME_smoothed``, is its smoothed end. (A
*residual row* is one scalar of a residual.) A *state* is a block or a derived quantity.
"""
