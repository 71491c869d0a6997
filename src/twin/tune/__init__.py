"""Searches over runs: gains for a family of rigs, parameters from tables of measured indicators."""
