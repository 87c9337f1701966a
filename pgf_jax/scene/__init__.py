"""Scenes: what stands on the shelf, where scenes come from, and how they look from above."""
