"""What esair costs, as ratios to a limit that is measured beside it.

Run ``python -m benchmarks`` in the checkout: one table, two minutes at most.
"""
