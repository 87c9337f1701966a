"""Studies: data collection, sweeps, results on disk and figures."""
