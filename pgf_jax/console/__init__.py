"""The operator's console: a fleet in real time, a person at the desk, and the page they look at."""
