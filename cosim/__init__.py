"""Co-simulation of the plant and controller FMUs: scenarios, master, results, metrics, plots, experiments."""
