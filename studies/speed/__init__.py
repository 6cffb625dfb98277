"""Time of steps and filters, beside baselines written by hand."""
