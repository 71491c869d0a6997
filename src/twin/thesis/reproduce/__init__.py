"""The tables of the thesis's chapter 8, computed anew and laid beside the thesis's values."""
