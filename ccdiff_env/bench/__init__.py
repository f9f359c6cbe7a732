"""Benchmarks of traffic and of planners: jobs in a run folder, tables, plots."""
