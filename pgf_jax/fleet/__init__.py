"""The fleet: simulated clock, allocation policies, simulator (core 2) and metrics."""
