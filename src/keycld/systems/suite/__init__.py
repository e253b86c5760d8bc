"""What the data sets of "Which priors matter?" share: pictures, random draws, solvers. The sets are in `catalogue/`."""
