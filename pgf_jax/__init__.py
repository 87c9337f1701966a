"""Throughput studies of one human guiding a fleet of robots that reach through clutter."""
