"""The tables of the thesis's chapter 8, recomputed and compared."""
