"""Synthesis: neighbours, priors, energy, solver, and the estimators made of them."""
