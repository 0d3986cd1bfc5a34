"""Many runs of one problem: a grid of values, seeds, processes or a cluster, one table."""
