"""Guidance: operators, and the predictors of what their help is worth."""
