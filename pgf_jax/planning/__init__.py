"""Planning: cost terms, nominal trajectories, updates and the planner (core 1)."""
